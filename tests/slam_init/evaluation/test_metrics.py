"""Laws of the trajectory metrics; the package evo is the independent reference."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PosePath3D
from make_map import make_map, make_poses, make_truth

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.evaluation.metrics import align_poses, ate_rmse, compare_with_groundtruth
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose, Trajectory


def noisy(poses, rng, scale=0.4):
    return [
        Pose(p.R @ rotation_from_vector(rng.normal(0, 0.02, 3)), scale * p.t + rng.normal(0, 0.02, 3)) for p in poses
    ]


def evo_path(poses):
    matrices = []
    for pose in poses:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.R, pose.t
        matrices.append(matrix)
    return PosePath3D(poses_se3=matrices)


def keyframes_of(poses, start=0.0):
    return [Keyframe(i, start + i / 10, f"{i}.png", pose) for i, pose in enumerate(poses)]


def trajectory_of(poses):
    return Trajectory(np.arange(len(poses)) / 10, tuple(poses))


@pytest.mark.parametrize("seed", range(5))
def test_ate_and_rpe_are_equal_to_those_of_evo(seed):
    rng = np.random.default_rng(seed)
    truth = make_poses(12)
    estimated = noisy(truth, rng)
    reference, aligned = evo_path(truth), evo_path(estimated)
    aligned.align(reference, correct_scale=True)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    ours = ate_rmse(np.array([p.t for p in estimated]), np.array([p.t for p in truth]))
    assert ours == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), abs=1e-9)


def test_the_error_of_collinear_positions_is_unique_although_their_rotation_is_not():
    a, b = np.zeros((4, 3)), np.zeros((4, 3))
    a[:, 0], b[:, 2] = [0, 1, 2, 3], [0, 1, 2, 3.4]
    slope, intercept = np.polyfit(a[:, 0], b[:, 2], 1)
    expected = np.sqrt(np.mean((b[:, 2] - slope * a[:, 0] - intercept) ** 2))
    assert ate_rmse(a, b) == pytest.approx(expected)


def test_poses_align_two_cameras_whose_positions_do_not_determine_a_rotation():
    map_ = make_map(keyframes=2)
    truth, estimated = make_truth(map_), [k.world_from_cam for k in map_.keyframes]
    similarity = align_poses(truth.world_from_cam, estimated)
    assert similarity.scale == pytest.approx(1 / 2.5)
    for mine, true in zip(estimated, truth.world_from_cam, strict=True):
        np.testing.assert_allclose(similarity.R @ true.R, mine.R, atol=1e-12)
        np.testing.assert_allclose(similarity.apply(true.t), mine.t, atol=1e-12)


def test_the_error_of_a_perfect_map_is_zero_for_any_frame_and_scale_of_the_truth():
    map_ = make_map()
    truth = make_truth(map_, scale=2.5)
    found = compare_with_groundtruth(map_.keyframes, truth)
    assert found is not None
    steps = np.diff([pose.t for pose in truth.world_from_cam], axis=0)
    assert found.path_length == pytest.approx(np.linalg.norm(steps, axis=1).sum())
    assert (found.rotation_error_deg, found.direction_error_deg, found.ate_rmse) == pytest.approx((0, 0, 0), abs=1e-5)


def test_the_reported_error_is_that_of_the_worst_keyframe():
    truth = make_poses(4)
    wrong = Pose(truth[2].R @ rotation_from_vector(np.deg2rad([0, 3.0, 0])), truth[2].t)
    found = compare_with_groundtruth(keyframes_of([truth[0], truth[1], wrong, truth[3]]), trajectory_of(truth))
    assert found is not None
    assert found.rotation_error_deg == pytest.approx(3)
    assert found.direction_error_deg == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize(("share", "expected"), [(0.29, 0.0), (0.31, 90.0)])
def test_short_baselines_do_not_count_for_the_direction(share, expected):
    truth = [Pose(np.eye(3), np.array(t, float)) for t in ([0, 0, 0], [share, 0, 0], [1, 0, 0])]
    estimated = [truth[0], Pose(np.eye(3), np.array([0, share, 0])), truth[2]]
    found = compare_with_groundtruth(keyframes_of(estimated), trajectory_of(truth))
    assert found is not None
    assert found.direction_error_deg == pytest.approx(expected)


def test_a_measured_truth_knows_the_direction_of_a_short_baseline_less_well():
    """A noise of .3 mm from pose to pose is that of a motion capture; a rendered truth and photographs tell nothing."""
    noise = np.random.default_rng(0).normal(scale=3e-4, size=(30, 3))
    for noisy, rate_hz, baseline, sigma_deg in (
        (1.0, 30.0, 0.05, 11.3),
        (1.0, 30.0, 0.5, 1.1),
        (0.0, 30.0, 0.05, 0.0),
        (1.0, 1.0, 0.05, 0.0),
    ):
        steps = baseline * np.linspace(0, 1, 30)[:, None] * [1.0, 0, 0]
        poses = [Pose(np.eye(3), t) for t in steps + noisy * noise]
        truth = Trajectory(np.arange(30) / rate_hz, tuple(poses))
        first, last = (Keyframe(k, k / rate_hz, str(k), Pose(np.eye(3), steps[k])) for k in (0, 29))
        found = compare_with_groundtruth([first, last], truth)
        assert found.true_direction_sigma_deg == pytest.approx(sigma_deg, abs=0.3)
        assert found.true_baseline == pytest.approx(baseline, rel=0.05)


def test_the_direction_error_of_a_reversed_or_missing_translation_is_180_degrees():
    truth = [Pose.identity(), Pose(np.eye(3), np.array([0.0, 0, 1]))]
    for t in ([0, 0, -1], [0, 0, 0]):
        found = compare_with_groundtruth(
            keyframes_of([truth[0], Pose(np.eye(3), np.array(t, float))]), trajectory_of(truth)
        )
        assert found is not None
        assert found.direction_error_deg == pytest.approx(180)


def test_a_static_true_camera_has_no_direction_and_no_scale():
    truth = [Pose.identity()] * 3
    found = compare_with_groundtruth(keyframes_of(make_poses(3)), trajectory_of(truth))
    assert found is not None
    assert found.direction_error_deg is None
    assert found.ate_rmse is None
    assert found.path_length == 0
    assert found.rotation_error_deg == pytest.approx(float(np.rad2deg(rotation_angle(make_poses(3)[2].R))))


def test_keyframes_without_true_poses_are_not_compared():
    poses = make_poses(3)
    assert compare_with_groundtruth(keyframes_of(poses), None) is None
    assert compare_with_groundtruth(keyframes_of(poses, start=100.0), trajectory_of(poses)) is None
    assert compare_with_groundtruth(keyframes_of(poses), Trajectory(np.zeros(0), ())) is None
