"""Pairs of frames: the first and the last of some observations."""

from collections.abc import Sequence

from make_scene import CAMERA, CONFIG

from quest.estimate import RelativePose
from slam_init.decision.two_views import MatchedPair, pose_at_fitting_threshold
from slam_init.frontend.keyframes import PairPreview, preview_pairs
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations


def preview_of(observations: Sequence[Observations], camera: Camera = CAMERA) -> PairPreview:
    """The preview of the first and the last frame."""
    return preview_pairs(camera, [observations[0]], observations[-1], CONFIG.map.noise_px)[0]


def matched(observations: Sequence[Observations], camera: Camera = CAMERA) -> MatchedPair:
    """The matches of the first and the last frame."""
    return MatchedPair(preview_of(observations, camera), observations[0], observations[-1])


def estimated(observations: Sequence[Observations], camera: Camera = CAMERA) -> RelativePose:
    """The relative pose of the first and the last frame, which exists."""
    pose, _ = pose_at_fitting_threshold(camera, CONFIG, matched(observations, camera))
    assert isinstance(pose, RelativePose)
    return pose
