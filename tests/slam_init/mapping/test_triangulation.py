"""Laws of triangulation and of resection."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from make_map import make_poses
from make_scene import CAMERA, cloud, observe

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.mapping.resection import resect, triangulate
from slam_init.types.pose import Pose

seeds = st.integers(0, 2**32 - 1)
THRESHOLD_RAD = 2.0 / CAMERA.focal_px


def rays(poses, points):
    directions = np.array([pose.inverse().apply(points) for pose in poses])
    return directions / np.linalg.norm(directions, axis=2, keepdims=True)


@given(seed=seeds, views=st.integers(2, 5))
@settings(max_examples=30)
def test_exact_rays_meet_in_their_point(seed, views):
    points, poses = cloud(np.random.default_rng(seed), 20), list(make_poses(views))
    np.testing.assert_allclose(triangulate(poses, rays(poses, points)), points, atol=1e-8)


@given(seed=seeds)
@settings(max_examples=30)
def test_moving_and_scaling_the_cameras_moves_and_scales_the_points(seed):
    rng = np.random.default_rng(seed)
    points, poses = cloud(rng, 20), list(make_poses(3))
    noisy = rays(poses, points) + rng.normal(0, 1e-3, (3, 20, 3))
    noisy /= np.linalg.norm(noisy, axis=2, keepdims=True)
    motion, scale = Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)), 3.0
    moved = [Pose(motion.R @ pose.R, scale * motion.R @ pose.t + motion.t) for pose in poses]
    expected = scale * triangulate(poses, noisy) @ motion.R.T + motion.t
    np.testing.assert_allclose(triangulate(moved, noisy), expected, atol=1e-6)


def test_parallel_rays_have_no_point():
    poses = [Pose.identity(), Pose(np.eye(3), np.array([0.1, 0, 0]))]
    ahead = np.array([[[0.0, 0, 1]], [[0.0, 0, 1]]])
    assert np.isnan(triangulate(poses, ahead)).all()


def test_cameras_in_one_place_see_no_depth():
    poses = [Pose.identity(), Pose(rotation_from_vector(np.array([0, 0.1, 0])), np.zeros(3))]
    assert np.isnan(triangulate(poses, rays(poses, np.array([[0.0, 0.1, 2.0]])))).all()


def test_one_ray_is_not_enough_and_a_missing_view_is_left_out():
    poses, points = list(make_poses(3)), cloud(np.random.default_rng(0), 3)
    seen = rays(poses, points)
    seen[1:, 0] = np.nan  # point 0: one ray
    seen[1, 1] = np.nan  # point 1: two rays
    found = triangulate(poses, seen)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], points[1:], atol=1e-8)


def assert_near(pose, truth, rotation_rad, length):
    assert rotation_angle(pose.R.T @ truth.R) < rotation_rad
    assert np.linalg.norm(pose.centre - truth.centre) < length


@given(seed=seeds)
@settings(max_examples=15)
def test_resection_finds_the_pose_and_the_outliers_among_a_third_of_outliers(seed):
    rng = np.random.default_rng(seed)
    points, truth = cloud(rng, 90), make_poses(4)[3]
    (seen,) = observe(CAMERA, [truth], points, 0.3, rng)
    pixels = seen.pixels.copy()
    pixels[:30] += rng.choice([-1, 1], (30, 2)) * rng.uniform(20, 100, (30, 2))
    cam_from_world, inliers = resect(points, CAMERA.bearings(pixels), THRESHOLD_RAD)
    assert_near(cam_from_world, truth.inverse(), 0.01, 0.01)
    assert not inliers[:30].any()
    assert inliers[30:].mean() > 0.9


def test_a_good_guess_gives_a_pose_where_the_minimal_solver_has_none():
    """Rays to the side and behind the camera have no point on the plane z = 1."""
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(60, 3))
    directions[:, 2] = -np.abs(directions[:, 2])
    points = 2 * directions
    truth = Pose(rotation_from_vector(np.array([0.02, 0.01, 0])), np.array([0.05, 0, 0.02]))
    bearings = truth.apply(points) / np.linalg.norm(truth.apply(points), axis=1, keepdims=True)
    assert resect(points, bearings, THRESHOLD_RAD) is None
    found = resect(points, bearings, THRESHOLD_RAD, guess=Pose.identity())
    assert_near(found[0], truth, 1e-6, 1e-6)


def test_too_few_or_unrelated_points_have_no_pose():
    rng = np.random.default_rng(6)
    points = cloud(rng)
    (seen,) = observe(CAMERA, [make_poses(2)[1]], points)
    assert resect(points[:5], seen.bearings[:5], THRESHOLD_RAD) is None
    assert resect(np.zeros((0, 3)), np.zeros((0, 3)), THRESHOLD_RAD) is None
    unrelated = CAMERA.bearings(rng.uniform((0, 0), (640, 480), (len(points), 2)))
    found = resect(points, unrelated, 0.1 * THRESHOLD_RAD)
    assert found is None or found[1].mean() < 0.2


def test_a_resection_that_runs_away_is_no_pose():
    """A start so far away that squares overflow, as a step along rays that are all alike leads to."""
    rng = np.random.default_rng(0)
    points = rng.normal((0.0, 0.0, 5.0), 1.0, (20, 3))
    bearings = np.tile([0.0, 0.0, 1.0], (20, 1))
    far = Pose(np.eye(3), np.array([0.0, 0.0, 1e160]))
    with np.errstate(all="raise"):
        assert resect(points, bearings, 1e-3, far) is None


def test_a_point_at_any_distance_is_an_inlier_if_its_ray_agrees():
    """Tracks that are nearly parallax-free put points so far away that the squares of coordinates overflow."""
    rng = np.random.default_rng(3)
    pose = Pose(rotation_from_vector(np.array([0.02, -0.05, 0.01])), np.array([0.3, -0.1, 0.05]))
    points = rng.uniform([-2.0, -2.0, 3.0], [2.0, 2.0, 6.0], (40, 3))
    points[0] = np.array([0.1, 0.2, 1.0]) * 1e200
    rays = pose.apply(points)
    bearings = rays / np.abs(rays).max(axis=1, keepdims=True)
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    with np.errstate(all="raise"):
        found = resect(points, bearings, 1e-3, Pose(pose.R, pose.t))
    assert found is not None and found[1].all()
