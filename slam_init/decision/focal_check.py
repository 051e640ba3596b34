"""The check of the stated focal length on frames that were refused as a pure rotation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from slam_init.config import Config
from slam_init.decision.rotation_only import fit_rotation_only, rotation_only_evidence
from slam_init.frontend.keyframes import PairPreview
from slam_init.frontend.tracks import History, common_tracks
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

#: A focal length that is wrong by 5 % moves the tracks by less than 0.2 px where the rotation is smaller than this.
#: Class: geometry.
_FIRST_CHECK_DEG = 5.0


class FocalCheck:
    """Checks the stated focal length of a rotating camera, each time it has rotated clearly farther than before."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._next_deg = _FIRST_CHECK_DEG

    def __call__(
        self, attempt: Attempt, pairs: Sequence[PairPreview], history: History, current: Observations
    ) -> Attempt:
        """Add the evidence of a check to an attempt, if a check is due.

        * ``attempt``: It is checked only if it was refused as a pure rotation and has no evidence of a rotation-only
          camera yet.
        * ``pairs``: Of all candidate references with the current frame. The pair with the largest rotation is checked.
        """
        if attempt.verdict != Verdict.PURE_ROTATION or attempt.rotation_only is not None:
            return attempt
        needed = self._config.keyframes.min_matches
        farthest = max(pairs, key=lambda pair: (pair.matches >= needed, pair.rotation_deg))
        if farthest.rotation_deg < self._next_deg:
            return attempt
        # Each check costs as much time as a frame, and a slightly larger rotation gives the same result.
        self._next_deg = self._config.keyframes.retry_gain * farthest.rotation_deg
        return with_focal_check(history.camera, self._config, attempt, history[farthest.reference], current)


def with_focal_check(
    camera: Camera, config: Config, attempt: Attempt, reference: Observations, current: Observations
) -> Attempt:
    """Add the focal length that the matches of a rotating camera suggest.

    * ``reference, current``: A pair with a large rotation. The larger the rotation, the clearer the effect of a wrong
      focal length.
    """
    i, j = common_tracks(reference, current)
    # A two-view estimate, if there is one, has measured the noise.
    two_view_px = None if attempt.two_view is None else attempt.two_view.noise_px
    noise_rad = max(config.map.noise_px, two_view_px or 0.0) / camera.focal_px
    rotation_only = fit_rotation_only(reference.bearings[i], current.bearings[j], noise_rad)
    evidence = rotation_only_evidence(camera, config, rotation_only, noise_rad)
    return replace(attempt, rotation_only=evidence)
