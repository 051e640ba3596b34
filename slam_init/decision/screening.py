"""Decision rules for all pairs of a frame, by their previews, before any epipolar geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_init.config import Config
from slam_init.frontend.keyframes import PairPreview, difference_gate
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.refusal import GateName, Stage, Verdict, at_least
from slam_init.types.result import Attempt

#: A tenth of the tracks may be outliers. If the rotation leaves more of the tracks displaced, the camera moved.
#: Class: assumption.
LEAST_PARALLAX_SHARE = 0.1
#: Where more of the image is masked, most features are, and the advice names the mask rather than the light.
#: Class: assumption.
_MUCH_MASKED = 0.5


def screen(
    camera: Camera, config: Config, current: Observations, pairs: Sequence[PairPreview], masked: float = 0.0
) -> Attempt | None:
    """Refuse all pairs of a frame at once where no pair can lead to a map.

    * ``pairs``: Of all candidate references with the current frame, the highest direction score first.
    * Returns: A refusal for lack of tracks or motion. None where a pair is worth trying, or there is no pair. A
      rotation is not refused here: the window recognizes a rotation-only camera by all its views.
    """
    if not pairs:
        return None
    needed = config.keyframes.min_matches
    usable = [pair for pair in pairs if pair.matches >= needed]
    pair = (usable or pairs)[0]
    motion_px = max((p.motion_px for p in usable), default=0.0)
    share = max((p.parallax_share for p in usable), default=0.0)
    noise_px = difference_gate(config.map.noise_px)
    mask_less = f"the mask ignores {masked:.0%} of the image: mask less of it" if masked > _MUCH_MASKED else None
    matches = (
        at_least(GateName.FEATURES, len(current), needed, Verdict.TOO_FEW_FEATURES, mask_less),
        at_least(GateName.MATCHES, pair.matches, needed, Verdict.TOO_FEW_MATCHES),
    )
    # Without parallax the camera only rotated, or was static. A rotation that is fitted to noise is close to zero.
    rotation_px = float(np.radians(max((p.rotation_deg for p in usable), default=0.0))) * camera.focal_px
    rotation = at_least(GateName.ROTATION_PX, rotation_px, noise_px, Verdict.STATIC_CAMERA)
    motion = (
        at_least(GateName.MOTION_PX, motion_px, noise_px, Verdict.STATIC_CAMERA),
        *([rotation] if share < LEAST_PARALLAX_SHARE else []),
    )
    # Accepted until a gate refuses it.
    attempt = Attempt((pair.reference, pair.current), Verdict.ACCEPTED, preview=pair.evidence)
    for stage, gates in ((Stage.MATCHES, matches), (Stage.MOTION, motion)):
        attempt = attempt.with_gates(gates)
        if any(not gate.passes() for gate in gates):
            return attempt.refused_by(stage, gates)
    return None
