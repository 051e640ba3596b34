"""The flow, its covariance, drifts over many steps, the exposure by trails, and tracks that their patches find."""

import cv2
import numpy as np
import pytest
from make_scene import SMALL_CAMERA as CAMERA
from make_scene import SMALL_SIZE as SIZE
from make_scene import texture, window

from slam_init.config import TrackingConfig
from slam_init.frontend.flow import expected_as_before, flow, follow
from slam_init.frontend.patches import Patches, smoothed
from slam_init.frontend.tracks import Tracker
from slam_init.types.frame import Observations

CONFIG = TrackingConfig()
TEXTURE = texture(1, 600, 1200)


def image(x, y, noise=0.0, trail_px=0, seed=0):
    """A view of the texture whose camera moves by ``trail_px`` to the right during the exposure."""
    shifts = np.arange(trail_px + 1) - trail_px / 2
    views = [window(TEXTURE, x + shift, y, *SIZE).image.astype(float) for shift in shifts]
    noisy = np.mean(views, axis=0) + noise * np.random.default_rng(seed).normal(size=SIZE[::-1])
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def corners(gray):
    return cv2.goodFeaturesToTrack(gray, 300, 0.002, 8, blockSize=5)[:, 0].astype(float)


def followed(before, after):
    start = corners(before)
    return start, flow(before, after, start, CONFIG)


def test_the_errors_of_a_step_have_the_order_of_the_stated_deviations():
    """The factor was measured on other images. These edges do not turn or bend, which the covariances allow for."""
    ratios = []
    for seed in range(4):
        start, found = followed(image(100, 60, 6.0, seed=seed), image(104.3, 61.7, 6.0, seed=seed + 50))
        errors = (found.pixels - start - (-4.3, -1.7))[found.kept]
        whitened = np.linalg.solve(np.linalg.cholesky(found.covariances[found.kept]), errors[..., None])
        ratios.append(np.median(np.abs(whitened)) / 0.6745)
    assert 0.3 < np.median(ratios) < 2.5


def test_a_track_on_a_straight_edge_slides_along_it():
    """The edge turns by two degrees: a displacement of the patch leaves a wedge, which pulls it along the edge."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:240, :320].astype(float)
    rough = cv2.GaussianBlur(rng.normal(size=(240, 320)), (0, 0), 2.0) * 30

    def edge(angle):
        across = (x - 160) * np.cos(angle) + (y - 120) * np.sin(angle)
        return np.clip(np.round(128 + 60 * np.tanh(across) + 0.5 * rough), 0, 255).astype(np.uint8)

    start = np.column_stack([np.full(9, 160.0), np.linspace(60, 180, 9)])
    found = flow(edge(0.0), edge(np.radians(2)), start, CONFIG)
    stated = np.sqrt(np.diagonal(found.covariances[found.kept], axis1=1, axis2=2))
    assert found.kept.sum() > 5
    assert (stated[:, 1] > 4 * stated[:, 0]).all()
    # The noise of the pixels alone would state .27 px.
    assert np.median(stated[:, 1]) > 0.6


def test_a_track_slides_along_the_trails_of_a_blurred_image():
    _, sharp = followed(image(100, 60, 3.0), image(110, 60, 3.0, seed=1))
    _, blurred = followed(image(100, 60, 3.0, trail_px=12), image(110, 60, 3.0, trail_px=12, seed=1))
    along, across = (np.median(blurred.covariances[blurred.kept][:, k, k]) for k in (0, 1))
    assert along > 2 * across
    along, across = (np.median(sharp.covariances[sharp.kept][:, k, k]) for k in (0, 1))
    assert 0.5 < along / across < 2


@pytest.mark.parametrize("gain", [0.4, 1.5])
def test_points_are_followed_where_the_brightness_changes(gain):
    before, after = image(100, 60, 1.0), image(103, 61, 1.0, seed=1)
    dim = (0.6 * before).astype(np.uint8)
    start, found = followed(dim, np.clip(gain * 0.6 * after, 0, 255).astype(np.uint8))
    assert found.kept.mean() > 0.8
    errors = np.linalg.norm(found.pixels - start - (-3, -1), axis=1)[found.kept]
    assert np.median(errors) < 0.15


def test_a_dark_wall_that_comes_into_view_is_no_change_of_brightness():
    """The camera turns, and the mean of the image falls by seven per cent: dimmed images would pull the points."""
    world = image(60, 60)
    panorama = np.hstack([world, world[:, ::-1] // 20])
    before, after = np.ascontiguousarray(panorama[:, :320]), np.ascontiguousarray(panorama[:, 24:344])
    assert after.mean() < 0.94 * before.mean()
    start, found = followed(before, after)
    stays = start[:, 0] > 44
    assert found.kept[stays].mean() > 0.9
    errors = np.linalg.norm(found.pixels - start - (-24, 0), axis=1)[found.kept & stays]
    assert np.median(errors) < 0.01


def test_points_that_are_not_where_they_are_expected_are_sought_in_all_octaves():
    before, after = image(100, 60), image(110, 55)
    start = corners(before)
    near, far = start + np.array([-10, 5]), start + np.array([90, -70])
    of_all, of_near, of_far = (flow(before, after, start, CONFIG, one) for one in (None, near, far))
    both = of_all.kept & of_near.kept & of_far.kept
    assert both.sum() > 0.95 * of_all.kept.sum()
    for one in (of_near, of_far):
        apart = np.linalg.norm(one.pixels - of_all.pixels, axis=1)[both]
        assert (apart < 0.1).mean() > 0.9  # a patch that looks alike may be where a point is expected


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_trails_of_a_blurred_image_determine_the_exposure(share):
    step_px = 16
    trail_px = round(share * step_px)
    _, found = followed(image(100, 60, 2.0, trail_px), image(100 + step_px, 60, 2.0, trail_px, seed=1))
    assert found.trail == pytest.approx(share, abs=0.3)


def test_the_drift_of_a_tracker_does_not_add_up_and_is_zero_for_new_tracks():
    tracker = Tracker(CAMERA, CONFIG)
    seen = [tracker.track(window(TEXTURE, 100 + 4.3 * k, 60 + 1.7 * k, *SIZE, index=k)) for k in range(6)]
    assert not seen[0].drifts.any()
    sizes = [np.trace(one.drifts, axis1=1, axis2=2)[np.isin(one.track_ids, seen[0].track_ids)] for one in seen]
    assert 0 < np.median(sizes[5]) < 1.5 * np.median(sizes[1])
    new = ~np.isin(seen[-1].track_ids, seen[-2].track_ids)
    assert not seen[-1].drifts[new].any()
    assert seen[-1].step_px > 0


def seen(gray):
    """The corners of a frame as tracks, and their patches."""
    pixels, patches = corners(gray), Patches()
    ids = np.arange(len(pixels))
    patches.follow(smoothed(gray), ids, pixels, np.zeros((len(pixels), 2, 2)))
    return Observations(0, 0.0, "", ids, pixels, CAMERA.bearings(pixels)), patches


def tracks_followed(before, after, moved):
    last, patches = seen(before)
    return last, *follow(before, after, smoothed(after), last, np.tile(moved, (len(last), 1)), patches, CONFIG)


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


def test_points_whose_last_step_is_not_known_are_expected_nowhere():
    before, after = image(100, 60), image(103, 61)
    start = corners(before)
    moved = np.tile([-3.0, -1.0], (len(start), 1))
    moved[::2] = np.nan
    assert np.isnan(expected_as_before(before, after, start, moved, CONFIG).pixels[::2]).all()
    moved[20:] = np.nan
    assert expected_as_before(before, after, start, moved, CONFIG) is None


def test_tracks_that_move_as_before_are_found_by_their_patches_where_flow_finds_them():
    before, after = image(100, 60), image(103.4, 60.8)
    last, found, sought = tracks_followed(before, after, (-3.0, -1.0))
    by_flow = flow(before, after, last.pixels, CONFIG)
    both = sought.found & by_flow.kept
    assert both.sum() > 0.85 * by_flow.kept.sum()
    assert np.linalg.norm(found.pixels - last.pixels - (-3.4, -0.8), axis=1)[both].max() < 0.3
    assert (np.linalg.norm(found.pixels - by_flow.pixels, axis=1)[both] < 0.1).mean() > 0.95


def test_a_track_without_a_patch_is_sought_by_flow():
    """As near the border of the image, or where it is flat."""
    before, after = image(100, 60), image(103, 61)
    last, patches = seen(before)
    half = last.track_ids[::2]
    patches.follow(smoothed(before), half, last.pixels[half], np.zeros((len(half), 2, 2)))
    moved = np.tile([-3.0, -1.0], (len(last), 1))
    found, sought = follow(before, after, smoothed(after), last, moved, patches, CONFIG)
    assert not sought.found[1::2].any()
    assert found.kept[1::2].mean() > 0.8
