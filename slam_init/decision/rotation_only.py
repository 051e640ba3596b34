"""What establishes that a camera only rotates.

A short translation looks like a rotation as well: the views do not distinguish them until one of them is long enough.
So a refusal says that the camera only rotates where the rotation has left its own evidence, else that there is not
enough translation yet.
"""

from __future__ import annotations

import math
from dataclasses import replace

from slam_init.types.camera import Camera
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt
from slam_init.window.levels import EVEN_ODDS

#: A translation along a frontal wall moves the tracks nearly as a rotation does. The median of what the best rotation
#: leaves of it is this share of r^2 of its displacement, with r half the diagonal of the image over the focal length:
#: .12 to .27 over fields of view of 30 to 90 degrees and all directions. Any other scene leaves more.
#: Class: geometry.
_LEFT_OF_A_WALL = 0.2
#: A rotation is established where what it leaves allows such a translation this share of the displacement at the most.
#: Two panoramas have .02 to .17 with a right lens and with an estimated one. Films that move have .39 and more where
#: a rotation explains their tracks still: a desk .8, a board .45, a simulated room .4 (Tsukuba).
#: Class: measured.
_ESTABLISHED = 0.25
_NOT_YET = "not enough translation yet: keep translating, best sideways"


def with_established_reason(camera: Camera, attempt: Attempt) -> Attempt:
    """A refusal as a pure rotation, with another reason where its evidence does not establish the rotation."""
    if attempt.verdict is not Verdict.PURE_ROTATION or _is_established(camera, attempt):
        return attempt
    gates = (
        replace(gate, reason=Verdict.LOW_PARALLAX, advice=_NOT_YET) if gate.reason is Verdict.PURE_ROTATION else gate
        for gate in attempt.gates
    )
    return replace(attempt, verdict=Verdict.LOW_PARALLAX, advice=_NOT_YET, gates=tuple(gates))


def _is_established(camera: Camera, attempt: Attempt) -> bool:
    """Whether a rotation explains the tracks, and what it leaves allows no translation of a good share of it."""
    preview, window = attempt.preview, attempt.window
    if preview is None or (window is not None and window.risk_rotation <= EVEN_ODDS):
        return False
    radius2 = min(((camera.width / 2) ** 2 + (camera.height / 2) ** 2) / camera.focal_px**2, 1.0)
    rotation_px = math.radians(preview.rotation_deg) * camera.focal_px
    return preview.parallax_px < _ESTABLISHED * _LEFT_OF_A_WALL * radius2 * rotation_px
