"""Pairs of real images: what is read is what the truth explains, and the tables say what was found."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from make_source import synth

from quest.geometry.quaternion import rotation_from_vector
from slam_init.benchmarks import real_pairs
from slam_init.benchmarks.image_pairs import (
    ImagePair,
    chessboard_pairs,
    match_features,
    pair_set,
    sequence_pairs,
    true_matches,
)
from slam_init.benchmarks.real_pairs import Group, run_group
from slam_init.errors import SourceError
from slam_init.frontend.sift import SiftFeatures, detect_sift, match_descriptors
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

CAMERA = Camera("radtan", 640, 480, 500.0, 505.0, 320.0, 240.0, (-0.2, 0.05, 0.001, 0.0))
TURN = Pose(rotation_from_vector(np.array([0.02, 0.1, 0.0])), np.array([-0.3, 0.0, 0.1]))


def true_share(pair, threshold_rad):
    return true_matches(pair, pair.bearings1, pair.bearings2, threshold_rad).mean()


def views(rng, count=80):
    """Raw pixels (count, 2) of points that two cameras see."""
    points = rng.uniform((-1, -0.7, 3), (1, 0.7, 5), (count, 3))
    return CAMERA.project(points), CAMERA.project(TURN.apply(points))


def write_chessboard(folder, rng):
    (folder / "images").mkdir()
    pixels = dict(zip(("a.png", "b.png"), views(rng, 54), strict=True))
    for name in pixels:
        cv2.imwrite(str(folder / "images" / name), np.zeros((480, 640), np.uint8))
    rows = [f"{name} {i} {u} {v}" for name, points in pixels.items() for i, (u, v) in enumerate(points)]
    (folder / "corners.txt").write_text("# image corner_id u v\n" + "\n".join(rows))
    (folder / "rgb.txt").write_text("0 images/a.png\n1 images/b.png\n")
    world_from_b = TURN.inverse()
    q, t = world_from_b.q_wxyz, world_from_b.t
    second = " ".join(map(repr, map(float, [*t, *q[1:], q[0]])))
    (folder / "groundtruth.txt").write_text(f"0 0 0 0 0 0 0 1\n1 {second}\n")
    (folder / "camera.yaml").write_text(
        "model: pinhole\nwidth: 640\nheight: 480\nfx: 500\nfy: 505\ncx: 320\ncy: 240\n"
        "distortion_model: radtan\ndistortion: [-0.2, 0.05, 0.001, 0.0]\n"
    )


def test_corners_are_matched_by_number_and_obey_the_true_pose(tmp_path):
    write_chessboard(tmp_path, np.random.default_rng(0))
    (pair,) = chessboard_pairs(tmp_path)
    assert len(pair.bearings1) == 54
    assert true_share(pair, 1e-6) == 1
    np.testing.assert_allclose(pair.cam2_from_cam1.t, TURN.t, atol=1e-12)


def test_features_are_matched_undistorted_and_in_front():
    rng = np.random.default_rng(1)
    pixels1, pixels2 = views(rng)
    descriptors = np.linalg.qr(rng.normal(size=(128, 80)))[0].T
    shuffle = rng.permutation(80)
    first, second = SiftFeatures(pixels1, descriptors), SiftFeatures(pixels2[shuffle], descriptors[shuffle])
    pair = match_features(CAMERA, first, CAMERA, second, TURN)
    assert len(pair.bearings1) == 80
    assert pair.distances.max() < 1e-6
    assert true_share(pair, 1e-6) == 1
    backwards = ImagePair(pair.bearings1, pair.bearings2, pair.distances, pair.focal_px, Pose(TURN.R, -TURN.t))
    assert true_share(backwards, 1e-6) == 0


def test_a_descriptor_with_a_rival_is_no_match():
    descriptors = np.eye(128)[:4]
    near = (descriptors[0] + 0.1 * descriptors[1]) / np.sqrt(1.01)
    assert [list(x) for x in match_descriptors(descriptors, descriptors, 0.8)] == [[0, 1, 2, 3], [0, 1, 2, 3]]
    i, _ = match_descriptors(descriptors, np.vstack([near, near, descriptors[1:]]), 0.8)
    assert 0 not in i
    assert len(detect_sift(np.zeros((60, 80), np.uint8), 100).pixels) == 0


def test_pairs_of_a_sequence_are_as_many_as_asked_for_and_obey_its_truth():
    source = synth("room", frames=12)
    pairs = list(sequence_pairs(source, 5, 2))
    assert len(pairs) == 2
    assert min(true_share(pair, 2 / pair.focal_px) for pair in pairs) > 0.8
    assert list(sequence_pairs(source, 12, 2)) == []


def test_a_pair_set_gives_its_poses_and_homographies_are_refused(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), cv2.resize(image, (640, 480)))
    K = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    T = np.eye(4)
    T[:3, 3] = TURN.t
    entry = {"image0": "a.png", "image1": "a.png", "width": 640, "height": 480, "K0": K, "K1": K}
    (tmp_path / "pairs.json").write_text(json.dumps([{**entry, "T_0to1": T.tolist()}]))
    (pair,) = pair_set(tmp_path)
    np.testing.assert_array_equal(pair.cam2_from_cam1.t, TURN.t)
    np.testing.assert_allclose(pair.bearings1, pair.bearings2)
    (tmp_path / "pairs.json").write_text(json.dumps([entry]))
    with pytest.raises(SourceError, match="T_0to1"):
        next(pair_set(tmp_path))


def test_a_pair_of_too_few_matches_counts_as_failed_for_all(tmp_path):
    write_chessboard(tmp_path, np.random.default_rng(0))
    (whole,) = chessboard_pairs(tmp_path)
    few = ImagePair(whole.bearings1[:9], whole.bearings2[:9], whole.distances[:9], 500.0, TURN)
    outcome = run_group(Group("g", lambda: iter([whole, few]), False), ["quest"], 2.0)
    good, failed = outcome.answers["quest"]
    assert good.kept_error_deg < 1
    assert (failed.kind, failed.error_deg) == ("none", np.inf)
    assert (outcome.matches, outcome.true_shares) == ([54, 9], [1.0])


def test_the_program_names_the_sets_and_refuses_a_folder_without_any(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert real_pairs.main([]) == 2
    assert "SLAM_INIT_DATA" in capsys.readouterr().err
    (tmp_path / "planar" / "opencv_chessboard").mkdir(parents=True)
    write_chessboard(tmp_path / "planar" / "opencv_chessboard", np.random.default_rng(0))
    assert real_pairs.main(["--methods", "quest", "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "out" / "real_pairs.md").read_text()
    assert "planar/opencv_chessboard, corners" in shown
