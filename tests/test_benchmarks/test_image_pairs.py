"""Pairs of real images: their matches agree with their true poses."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from make_chessboard import CAMERA, MOTION, two_views, write_chessboard
from make_source import synth

from slam_init.errors import SourceError
from slam_init.frontend.sift import SiftFeatures
from slam_init.types.pose import Pose
from tests.benchmarks.image_pairs import (
    ImagePair,
    chessboard_pairs,
    match_features,
    pair_set,
    sequence_pairs,
    true_matches,
)


def true_share(pair, threshold_rad):
    return true_matches(pair, pair.bearings1, pair.bearings2, threshold_rad).mean()


def test_corners_are_matched_by_number_and_agree_with_the_true_pose(tmp_path):
    write_chessboard(tmp_path, np.random.default_rng(0))
    (pair,) = chessboard_pairs(str(tmp_path))
    assert len(pair.bearings1) == 54
    assert true_share(pair, 1e-6) == 1
    np.testing.assert_allclose(pair.cam2_from_cam1.t, MOTION.t, atol=1e-12)


def test_matches_are_undistorted_and_true_matches_lie_in_front_of_both_cameras():
    rng = np.random.default_rng(1)
    pixels1, pixels2 = two_views(rng)
    descriptors = np.linalg.qr(rng.normal(size=(128, 80)))[0].T
    shuffle = rng.permutation(80)
    first, second = SiftFeatures(pixels1, descriptors), SiftFeatures(pixels2[shuffle], descriptors[shuffle])
    pair = match_features(CAMERA, first, CAMERA, second, MOTION)
    assert len(pair.bearings1) == 80
    assert pair.distances.max() < 1e-6
    assert true_share(pair, 1e-6) == 1
    backwards = ImagePair(pair.bearings1, pair.bearings2, pair.distances, pair.focal_px, Pose(MOTION.R, -MOTION.t))
    assert true_share(backwards, 1e-6) == 0


def test_pairs_of_a_sequence_have_the_requested_number_and_agree_with_its_ground_truth():
    source = synth("room", frames=12, width=320, height=240)
    pairs = list(sequence_pairs(source, 5, 2))
    assert len(pairs) == 2
    assert min(true_share(pair, 2 / pair.focal_px) for pair in pairs) > 0.8
    assert list(sequence_pairs(source, 12, 2)) == []


def test_a_pair_set_gives_its_poses_and_an_entry_without_a_pose_is_an_error(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), cv2.resize(image, (640, 480)))
    K = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    T = np.eye(4)
    T[:3, 3] = MOTION.t
    entry = {"image0": "a.png", "image1": "a.png", "width": 640, "height": 480, "K0": K, "K1": K}
    (tmp_path / "pairs.json").write_text(json.dumps([{**entry, "T_0to1": T.tolist()}]))
    (pair,) = pair_set(tmp_path)
    np.testing.assert_array_equal(pair.cam2_from_cam1.t, MOTION.t)
    np.testing.assert_allclose(pair.bearings1, pair.bearings2)
    (tmp_path / "pairs.json").write_text(json.dumps([entry]))
    with pytest.raises(SourceError, match="T_0to1"):
        next(pair_set(tmp_path))
