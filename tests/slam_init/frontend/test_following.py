"""Where tracks are expected in the next frame, and which of them their patches find there without flow."""

import cv2
import numpy as np
import pytest
from make_scene import SMALL_CAMERA as CAMERA
from make_scene import SMALL_SIZE as SIZE
from make_scene import texture, window

from slam_init.config import TrackingConfig
from slam_init.frontend.flow import flow
from slam_init.frontend.following import expected_as_before, follow
from slam_init.frontend.patches import Patches, smoothed
from slam_init.types.frame import Observations

CONFIG = TrackingConfig()
TEXTURE = texture(1, 600, 1200)


def image(x, y):
    return window(TEXTURE, x, y, *SIZE).image


def corners(gray):
    return cv2.goodFeaturesToTrack(gray, 300, 0.002, 8, blockSize=5)[:, 0].astype(float)


def seen(gray):
    """The corners of a frame as tracks, and their patches."""
    pixels, patches = corners(gray), Patches()
    ids = np.arange(len(pixels))
    patches.follow(smoothed(gray), ids, pixels, np.zeros((len(pixels), 2, 2)))
    return Observations(0, 0.0, "", ids, pixels, CAMERA.bearings(pixels)), patches


def followed(before, after, moved):
    last, patches = seen(before)
    return last, follow(before, after, smoothed(after), last, np.tile(moved, (len(last), 1)), patches, CONFIG)


@pytest.mark.parametrize("shake", [(0.0, 0.0), (14.0, -9.0)])
def test_points_are_expected_where_they_go_on_but_for_a_shift_of_the_whole_image(shake):
    """All moved by (3, 1) before, and the camera turns besides."""
    before, after = image(100, 60), image(103 + shake[0], 61 + shake[1])
    start = corners(before)
    expected = expected_as_before(before, after, start, np.tile([-3.0, -1.0], (len(start), 1)), CONFIG)
    np.testing.assert_allclose(
        expected.pixels - start, np.tile([-3 - shake[0], -1 - shake[1]], (len(start), 1)), atol=0.1
    )
    assert expected.closely


def test_tracks_that_move_as_before_are_found_by_their_patches_where_flow_finds_them():
    before, after = image(100, 60), image(103.4, 60.8)
    last, found = followed(before, after, (-3.0, -1.0))
    by_flow = flow(before, after, last.pixels, CONFIG)
    both = found.sought.found & by_flow.kept
    assert both.sum() > 0.85 * by_flow.kept.sum()
    assert np.linalg.norm(found.flow.pixels - last.pixels - (-3.4, -0.8), axis=1)[both].max() < 0.3
    assert (np.linalg.norm(found.flow.pixels - by_flow.pixels, axis=1)[both] < 0.1).mean() > 0.95
