"""Patches of tracks on a texture that a known map moves: where they end, what they refuse, when they are cut again."""

import cv2
import numpy as np
from make_scene import texture

from slam_init.config import TrackingConfig
from slam_init.frontend.patches import Patches, smoothed
from slam_init.frontend.tracks import Tracker
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.history import common_tracks

SIZE = (320, 240)
CENTRE = np.array([160.0, 120.0])
TEXTURE = texture(3, SIZE[1], SIZE[0])
#: The view turns about an upright axis: the texture shrinks to the right, and is sheared.
SHEARED = np.array([[0.96, 0.05], [-0.03, 1.02]])


def moved(A, shift=(0.0, 0.0), noise=0.0, seed=0):
    """The texture under ``x -> centre + A (x - centre) + shift``, and that map."""
    offset = CENTRE - A @ CENTRE + shift
    image = cv2.warpAffine(TEXTURE, np.column_stack([A, offset]), SIZE, borderMode=cv2.BORDER_REFLECT_101)
    noisy = image + noise * np.random.default_rng(seed).normal(size=image.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8), lambda pixels: pixels @ A.T + offset


def corners(gray, margin=45):
    found = cv2.goodFeaturesToTrack(gray, 200, 0.01, 8, blockSize=5)[:, 0].astype(float)
    return found[(np.abs(found - CENTRE) < CENTRE - margin).all(axis=1)]


def cut(image, pixels, ids=None):
    patches = Patches()
    ids = np.arange(len(pixels)) if ids is None else ids
    patches.follow(smoothed(image), ids, pixels, np.zeros((len(pixels), 2, 2)))
    return patches


def aligned(patches, image, pixels, ids=None, remainders=0.0):
    ids = np.arange(len(pixels)) if ids is None else ids
    return patches.align(smoothed(image), ids, pixels, np.full(len(pixels), remainders))


def test_a_sheared_patch_comes_back_to_its_point_from_where_flow_ends():
    """Flow moves a patch by a displacement alone, and its errors are several times as large."""
    start = corners(TEXTURE)
    image, true = moved(SHEARED, (1.3, -0.8))
    flow, _, _ = cv2.calcOpticalFlowPyrLK(TEXTURE, image, start.astype(np.float32), None, winSize=(21, 21))
    found = aligned(cut(TEXTURE, start), image, flow.astype(float))
    errors = np.linalg.norm(found.pixels - true(start), axis=1)
    of_flow = np.linalg.norm(flow - true(start), axis=1)
    assert found.succeeded.mean() > 0.8
    assert np.median(errors[found.succeeded]) < 0.05
    assert np.median(of_flow[found.succeeded]) > 4 * np.median(errors[found.succeeded])


def test_the_stated_drifts_are_the_errors_of_noisy_images():
    start = corners(TEXTURE)
    first, _ = moved(np.eye(2), noise=4.0, seed=1)
    image, true = moved(SHEARED, (1.3, -0.8), noise=4.0, seed=2)
    found = aligned(cut(first, start), image, true(start) + 0.2)
    errors = (found.pixels - true(start))[found.succeeded]
    whitened = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(found.drifts[found.succeeded]), errors)
    assert 0.4 < np.sqrt(np.median(whitened) / 1.386) < 1.6


def test_flat_patches_are_not_cut_and_tracks_on_a_line_are_aligned():
    image = TEXTURE.copy()
    cv2.circle(image, (160, 120), 30, 255, -1)
    line = np.column_stack([np.linspace(40, 280, 30), np.full(30, 60.0)])
    found = aligned(cut(image, np.vstack([line, CENTRE])), image, np.vstack([line, CENTRE]))
    assert found.succeeded[:30].mean() > 0.8
    assert not found.succeeded[30]
    assert not aligned(cut(np.zeros_like(image), line), image, line).succeeded.any()


def test_what_hides_a_patch_leaves_it_where_flow_ends_and_is_cut_after_some_frames():
    start = corners(TEXTURE)
    covered = TEXTURE.copy()
    covered[:, :160] = texture(9, SIZE[1], 160)
    hidden = start[:, 0] < 145
    patches = cut(TEXTURE, start)
    for _ in range(3):
        found = aligned(patches, covered, start)
        assert not found.succeeded[hidden].any()
        np.testing.assert_array_equal(found.pixels[hidden], start[hidden])
        assert found.succeeded[start[:, 0] > 175].all()
        patches.follow(smoothed(covered), np.arange(len(start)), start, np.zeros((len(start), 2, 2)))
    assert aligned(patches, covered, start).succeeded[hidden].mean() > 0.9


def test_the_errors_of_a_tracker_do_not_grow_with_the_change_of_the_view():
    """A plane that turns by a quarter of a radian: a track that only moves its patch is off by more in each frame."""
    wide, K = texture(5, 600, 800), np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])

    def view(k):
        c, s = np.cos(0.02 * k), np.sin(0.02 * k)
        plane = np.array([[c, 0, 0.003 * k], [0, 1, 0], [s, 0, 1]])  # of the points (X, Y, 1) of a plane in front
        return K @ plane @ np.linalg.inv(K) @ np.array([[1.0, 0, -240], [0, 1, -180], [0, 0, 1]])

    def see(k):
        return Frame(k, k / 30, "", cv2.warpPerspective(wide, view(k), SIZE, flags=cv2.INTER_AREA))

    tracker = Tracker(Camera("pinhole", *SIZE, 400.0, 400.0, 160.0, 120.0), TrackingConfig())
    seen = [tracker.track(see(k)) for k in range(13)]
    medians = []
    for k in (2, 12):
        i, j = common_tracks(seen[0], seen[k])
        H = view(k) @ np.linalg.inv(view(0))
        true = np.column_stack([seen[0].pixels[i], np.ones(len(i))]) @ H.T
        medians.append(np.median(np.linalg.norm(seen[k].pixels[j] - true[:, :2] / true[:, 2:], axis=1)))
    assert medians[1] < 0.08
    assert medians[1] < 2.5 * medians[0]
