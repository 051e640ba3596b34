"""SIFT features and their matches; one point in each cell."""

import cv2
import numpy as np
import pytest

from slam_init.frontend import sift as sift_module
from slam_init.frontend.sift import detect_sift, match_descriptors


def test_a_descriptor_with_two_similar_candidates_is_not_matched():
    descriptors = np.eye(128)[:4]
    near = (descriptors[0] + 0.1 * descriptors[1]) / np.sqrt(1.01)
    assert [list(x) for x in match_descriptors(descriptors, descriptors, 0.8)] == [[0, 1, 2, 3], [0, 1, 2, 3]]
    i, _ = match_descriptors(descriptors, np.vstack([near, near, descriptors[1:]]), 0.8)
    assert 0 not in i


def test_an_image_that_is_not_looked_at_has_no_features():
    """Those of a range below the limit, by OpenCV itself: blocks of all sizes, whose contrast is the whole range."""
    rng = np.random.default_rng(0)
    sift = cv2.SIFT.create(enable_precise_upscale=True)
    for block in (1, 2, 4, 8, 16):
        image = np.kron(rng.integers(0, 2, (128 // block, 160 // block)), np.ones((block, block)))
        faint = np.round(100 + (sift_module._LEAST_RANGE - 1) * image).astype(np.uint8)
        assert not sift.detect(faint, None) and len(detect_sift(faint, 100).pixels) == 0
        assert len(detect_sift(np.round(200 * image).astype(np.uint8), 100).pixels) > 0


@pytest.mark.parametrize(("size", "halved"), [(200, 1), (1501, 2)])
def test_keypoints_lie_in_the_middle_of_blobs(size, halved):
    """Of Gaussian blobs at places between pixels, also where the image is halved; the median shows a shift of all."""
    grid = np.stack(np.meshgrid(*[np.arange(30, 190, 40)] * 2), axis=-1).reshape(-1, 2) * halved
    centres = grid + np.random.default_rng(0).uniform(-0.5, 0.5, grid.shape)
    image = np.full((size, size), 60.0)
    for u, v in centres:
        y, x = np.mgrid[int(v) - 20 * halved : int(v) + 20 * halved, int(u) - 20 * halved : int(u) + 20 * halved]
        image[y, x] += 120 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (18 * halved**2))
    found = detect_sift(np.clip(np.round(image), 0, 255).astype(np.uint8), 500).pixels
    nearest = found[np.argmin(np.linalg.norm(found[None] - centres[:, None], axis=2), axis=1)]
    np.testing.assert_allclose(np.median(nearest - centres, axis=0), 0.0, atol=0.05 * halved)
