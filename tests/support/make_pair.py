"""Pairs of frames for the stages of an attempt: the first and the last of some observations."""

from __future__ import annotations

from collections.abc import Sequence

from make_scene import CAMERA, CONFIG, history_of

from slam_init.attempt import estimate_two_views
from slam_init.decision.two_views import MatchedPair, TwoViewEstimate, match_pair
from slam_init.frontend.keyframes import PairPreview, preview_pair
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations


def preview_of(observations: Sequence[Observations], camera: Camera = CAMERA) -> PairPreview:
    """The preview of the first and the last frame."""
    return preview_pair(camera, observations[0], observations[-1], CONFIG.map.noise_px)


def matched(observations: Sequence[Observations], camera: Camera = CAMERA) -> MatchedPair:
    """The matches of the first and the last frame."""
    return match_pair(history_of(observations), preview_of(observations, camera), observations[-1])


def estimated(observations: Sequence[Observations], camera: Camera = CAMERA) -> TwoViewEstimate:
    """The two-view estimate of the first and the last frame, which has a pose."""
    estimate = estimate_two_views(camera, CONFIG, matched(observations, camera))
    assert isinstance(estimate, TwoViewEstimate)
    return estimate
