"""The two views of a pair: their matches, their relative pose, and when it is said that the camera only rotates.

A short translation looks like a rotation as well: the views do not distinguish them until one of them is long enough.
So a refusal says that the camera only rotates where the rotation has left its own evidence, else that there is not
enough translation yet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from quest.estimate import NoPose, RelativePose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle
from slam_init.config import Config
from slam_init.frontend.keyframes import PairPreview, difference_gate
from slam_init.types.arrays import Floats, Ints, set_fields
from slam_init.types.camera import Camera
from slam_init.types.evidence import TwoViewEvidence
from slam_init.types.frame import Observations
from slam_init.types.history import common_tracks
from slam_init.types.refusal import GateName, Stage, Verdict, at_least
from slam_init.types.result import Attempt
from slam_init.window.levels import EVEN_ODDS

#: The outlier threshold should be three standard deviations of the noise. Where the noise of the inliers is more than
#: half of the threshold, the threshold has cut off many correct matches: inliers that fill the threshold evenly have a
#: standard deviation of 0.58 of it. The threshold is then widened once by a factor of three, from the value for a noise
#: of 0.7 px to the value for a noise of 2 px.
#: Class: level.
_TOO_NOISY_SIGMAS, _WIDER = 2.0, 3.0
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


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """The matches of a pair: the tracks that both views see."""

    preview: PairPreview
    #: reference, current: The two views, in time order.
    reference: Observations
    current: Observations
    #: pixels1, pixels2: (N, 2) Raw pixels in the reference and in the current view.
    pixels1: Floats = field(init=False)
    pixels2: Floats = field(init=False)
    #: rays1, rays2: (N, 3) Unit bearings in the two camera frames.
    rays1: Floats = field(init=False)
    rays2: Floats = field(init=False)
    #: (N,)
    track_ids: Ints = field(init=False)

    def __post_init__(self) -> None:
        i, j = common_tracks(self.reference, self.current)
        set_fields(self, pixels1=self.reference.pixels[i], rays1=self.reference.bearings[i])
        set_fields(self, pixels2=self.current.pixels[j], rays2=self.current.bearings[j])
        set_fields(self, track_ids=self.reference.track_ids[i])


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


def refuse_two_views(camera: Camera, config: Config, attempt: Attempt, pose: RelativePose | NoPose) -> Attempt:
    """Refuse a pair without a translation: one without a pose, or whose pose is a pure rotation.

    The camera is static if the rotation is within the noise that it was fitted to.
    """
    if isinstance(pose, NoPose):
        return attempt.refused_at(Verdict(pose.reason), Stage.TWO_VIEWS)
    least_px = difference_gate(max(config.map.noise_px, pose.noise_rad * camera.focal_px))
    rotation_px = float(rotation_angle(pose.R)) * camera.focal_px
    gate = at_least(GateName.ROTATION_PX, rotation_px, least_px, Verdict.STATIC_CAMERA)
    attempt = attempt.with_gates((gate,))
    if not gate.passes():
        return attempt.refused_by(Stage.MOTION, (gate,))
    return attempt.refused_at(Verdict.PURE_ROTATION, Stage.MOTION)


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
