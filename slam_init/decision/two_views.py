"""The two views of a pair: their matches, their relative pose, and the refusal of a pure rotation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import NoPose, RelativePose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle
from slam_init.config import Config
from slam_init.frontend.keyframes import PairPreview, difference_gate
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.evidence import TwoViewEvidence
from slam_init.types.frame import Observations
from slam_init.types.history import History, common_tracks
from slam_init.types.refusal import GateName, Stage, Verdict, at_least
from slam_init.types.result import Attempt

#: The outlier threshold should be three standard deviations of the noise. Where the noise of the inliers is more than
#: half of the threshold, the threshold has cut off many correct matches: inliers that fill the threshold evenly have a
#: standard deviation of 0.58 of it. The threshold is then widened once by a factor of three, from the value for a noise
#: of 0.7 px to the value for a noise of 2 px.
#: Class: level.
_TOO_NOISY_SIGMAS, _WIDER = 2.0, 3.0


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """The matches of a pair: the tracks that both views see."""

    preview: PairPreview
    #: reference, current: The two views, in time order.
    reference: Observations
    current: Observations
    #: pixels1, pixels2: (N, 2) Raw pixels in the reference and in the current view.
    pixels1: Floats
    pixels2: Floats
    #: rays1, rays2: (N, 3) Unit bearings in the two camera frames.
    rays1: Floats
    rays2: Floats
    #: (N,)
    track_ids: Ints

    def at(self, positions: Ints) -> MatchedPair:
        """Some of the matches.

        Shapes: ``positions`` (M,).
        """
        return replace(
            self,
            pixels1=self.pixels1[positions],
            pixels2=self.pixels2[positions],
            rays1=self.rays1[positions],
            rays2=self.rays2[positions],
            track_ids=self.track_ids[positions],
        )


def match_pair(history: History, preview: PairPreview, current: Observations) -> MatchedPair:
    """Gather the tracks that the reference of a pair and the current frame have in common."""
    reference = history[preview.reference]
    i, j = common_tracks(reference, current)
    return MatchedPair(
        preview=preview,
        reference=reference,
        current=current,
        pixels1=reference.pixels[i],
        pixels2=current.pixels[j],
        rays1=reference.bearings[i],
        rays2=current.bearings[j],
        track_ids=reference.track_ids[i],
    )


#: ``propose(camera, config, pair)`` returns the relative pose of a pair and the outlier threshold in radians.
Proposer = Callable[[Camera, Config, MatchedPair], tuple[RelativePose | NoPose, float]]


def pose_at_fitting_threshold(camera: Camera, config: Config, pair: MatchedPair) -> tuple[RelativePose | NoPose, float]:
    """Estimate the relative pose of a pair; the outlier threshold is widened once for noisy tracks."""
    threshold_rad = config.two_view.threshold_px / camera.focal_px
    pose = estimate_relative_pose(pair.rays1, pair.rays2, threshold_rad=threshold_rad, seed=config.seed)
    if isinstance(pose, RelativePose) and pose.noise_rad > threshold_rad / _TOO_NOISY_SIGMAS:
        wider_rad = min(_WIDER * threshold_rad, 1.0)
        again = estimate_relative_pose(pair.rays1, pair.rays2, threshold_rad=wider_rad, seed=config.seed)
        if isinstance(again, RelativePose) and again.kind != "rotation":
            return again, wider_rad
    return pose, threshold_rad


def pose_evidence(camera: Camera, pose: RelativePose | NoPose) -> TwoViewEvidence:
    """Return the figures of a relative pose as evidence of an attempt."""
    if isinstance(pose, NoPose):
        return TwoViewEvidence(pose.evidence)
    return TwoViewEvidence(
        statistics=pose.evidence,
        kind=pose.kind,
        alternatives=len(pose.alternatives),
        noise_px=pose.noise_rad * camera.focal_px,
        parallax_deg=float(np.degrees(pose.parallax_rad)),
        direction_sigma_deg=float(np.degrees(pose.direction_sigma_rad)),
    )


def refuse_rotation(camera: Camera, config: Config, attempt: Attempt, pose: RelativePose) -> Attempt:
    """Refuse a pure rotation; a static camera if the rotation is within the noise that it was fitted to."""
    least_px = difference_gate(max(config.map.noise_px, pose.noise_rad * camera.focal_px))
    rotation_px = float(rotation_angle(pose.R)) * camera.focal_px
    gate = at_least(GateName.ROTATION_PX, rotation_px, least_px, Verdict.STATIC_CAMERA)
    attempt = attempt.with_gates((gate,))
    if not gate.passes():
        return attempt.refused_by(Stage.MOTION, (gate,))
    return attempt.refused_at(Verdict.PURE_ROTATION, Stage.MOTION)
