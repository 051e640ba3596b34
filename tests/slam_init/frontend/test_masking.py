"""Masks: no track uses an ignored pixel, by flow or by descriptors, and what such pixels show changes nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from make_scene import SMALL_CAMERA as CAMERA
from make_scene import SMALL_SIZE as SIZE
from make_scene import texture, window
from scipy.ndimage import distance_transform_cdt

from slam_init.config import TrackingConfig
from slam_init.frontend.tracks import Tracker
from slam_init.types.history import common_tracks

CONFIG = TrackingConfig()
RADIUS = CONFIG.window_px // 2
TEXTURE = texture(1, 500, 900)
#: The lower part and a column are ignored.
MASK = np.full(SIZE[::-1], 255, np.uint8)
MASK[170:] = 0
MASK[:, 150:154] = 0
#: Flow follows small steps; descriptors link the frames that are far apart.
STEPS = {"flow": [(100 + 5 * k, 60 + k) for k in range(6)], "descriptors": [(100 + 60 * k, 60) for k in range(3)]}


def frames_of(steps, mask, behind=1):
    """Frames whose ignored pixels show noise of this seed."""
    frames = []
    for k, (x, y) in enumerate(STEPS[steps]):
        frame = window(TEXTURE, x, y, *SIZE, index=k)
        noise = np.random.default_rng((behind, k)).integers(0, 256, frame.image.shape, dtype=np.uint8)
        image = frame.image if mask is None else np.where(mask > 0, frame.image, noise)
        frames.append(replace(frame, image=image, mask=mask))
    return frames


@cache
def followed(steps, behind):
    """The history of the frames whose ignored pixels show noise of this seed."""
    return follow(frames_of(steps, MASK, behind))[1]


def follow(frames):
    tracker = Tracker(CAMERA, CONFIG)
    seen = [tracker.track(frame) for frame in frames]
    return seen, list(tracker.history)


def distances_px(pixels):
    """Distance of each point from the nearest ignored pixel, along rows and columns."""
    column, row = np.clip(np.round(pixels).astype(int), 0, (SIZE[0] - 1, SIZE[1] - 1)).T
    return distance_transform_cdt(MASK > 0, "chessboard")[row, column]


@pytest.mark.parametrize("steps", STEPS)
def test_no_track_comes_near_an_ignored_pixel(steps):
    free, _ = follow(frames_of(steps, None))
    history = followed(steps, 1)
    assert any((distances_px(observed.pixels) < 1).any() for observed in free)
    for observed in history:
        least = RADIUS if steps == "flow" else 1
        assert len(observed) > 20 and distances_px(observed.pixels).min() > least - 0.5


@pytest.mark.parametrize("steps", STEPS)
def test_what_ignored_pixels_show_changes_nothing(steps):
    for one, other in zip(followed(steps, 1), followed(steps, 2), strict=True):
        assert np.array_equal(one.track_ids, other.track_ids)
        assert np.array_equal(one.pixels, other.pixels)
        assert np.array_equal(one.drifts, other.drifts)


def test_tracks_that_enter_the_mask_end_and_others_go_on():
    seen, _ = follow(frames_of("flow", MASK))
    i, _ = common_tracks(seen[0], seen[-1])
    ended = np.setdiff1d(np.arange(len(seen[0])), i)
    moved = seen[0].pixels - 5 * np.array([5.0, 1.0])  # where a point of the texture is in the last frame
    enters = (distances_px(moved) <= RADIUS - 1) & (moved >= 0).all(axis=1)
    assert len(i) > 0.4 * len(seen[0]) and enters.sum() > 5
    assert np.isin(np.flatnonzero(enters), ended).all()
