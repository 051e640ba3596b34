"""SIFT features and their matches."""

import numpy as np

from slam_init.frontend.sift import detect_sift, match_descriptors


def test_a_descriptor_with_two_similar_candidates_is_not_matched():
    descriptors = np.eye(128)[:4]
    near = (descriptors[0] + 0.1 * descriptors[1]) / np.sqrt(1.01)
    assert [list(x) for x in match_descriptors(descriptors, descriptors, 0.8)] == [[0, 1, 2, 3], [0, 1, 2, 3]]
    i, _ = match_descriptors(descriptors, np.vstack([near, near, descriptors[1:]]), 0.8)
    assert 0 not in i


def test_a_blank_image_has_no_features():
    assert len(detect_sift(np.zeros((60, 80), np.uint8), 100).pixels) == 0
