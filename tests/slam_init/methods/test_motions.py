"""Laws of fundamental matrices and homographies, of their motions, and of the check of motions by triangulation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from two_view_scenes import CAMERA

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.methods.models import fundamentals, homographies
from slam_init.methods.motions import CheckRule, check_motions, motions_of_essential, motions_of_homography
from slam_init.types.pose import Pose


def views(seed, count=60, planar=False):
    """Exact pixels of points in two views, and cam2_from_cam1 with |t| = 1."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -1.5, 4], [2, 1.5, 8], (count, 3))
    if planar:
        points[:, 2] = 6 + 0.4 * points[:, 0] - 0.3 * points[:, 1]
    t = rng.normal(size=3)
    pose = Pose(rotation_from_vector(0.1 * rng.normal(size=3)), t / np.linalg.norm(t))
    # Some pixels lie outside of the image, which does not matter here.
    return CAMERA.project(points), CAMERA.project(pose.apply(points)), pose


def contains(R, t, pose):
    """Whether exactly one of the motions is the pose."""
    near = [rotation_angle(a.T @ pose.R) < 1e-5 and a_t @ pose.t > 1 - 1e-9 for a, a_t in zip(R, t, strict=True)]
    return sum(near) == 1


# Eight points can lie near a critical surface, so the motion is estimated from twelve points or more.
@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(12, 30))
def test_the_motions_of_an_essential_matrix_contain_the_true_one(seed, count):
    pixels1, pixels2, pose = views(seed, count)
    F = fundamentals(pixels1, pixels2, np.arange(count)[None])[0]
    R, t = motions_of_essential(CAMERA.K.T @ F @ CAMERA.K)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    assert contains(R, t, pose)


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_the_motions_of_a_homography_contain_the_true_one(seed):
    pixels1, pixels2, pose = views(seed, planar=True)
    H = homographies(pixels1, pixels2, np.arange(60)[None])[0]
    R, t = motions_of_homography(np.linalg.inv(CAMERA.K) @ H @ CAMERA.K, 1.0)
    assert R.shape == (8, 3, 3)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-9)
    assert contains(R, t, pose)


@pytest.mark.parametrize("midpoint", [False, True])
def test_only_the_true_motion_puts_all_points_in_front(midpoint):
    pixels1, pixels2, pose = views(3)
    rays1, rays2 = CAMERA.bearings(pixels1), CAMERA.bearings(pixels2)
    F = fundamentals(pixels1, pixels2, np.arange(60)[None])[0]
    R, t = motions_of_essential(CAMERA.K.T @ F @ CAMERA.K)
    rule = CheckRule(max_error_px=1e-3, distant_cos=1.0, midpoint=midpoint)
    check = check_motions(CAMERA, R, t, rays1, rays2, np.ones(60, bool), rule)
    counts = check.good.sum(axis=1)
    assert sorted(counts)[-1] == 60
    assert sorted(counts)[-2] < 60
    best = int(np.argmax(counts))
    np.testing.assert_allclose(check.pose(best).R, pose.R, atol=1e-6)
    np.testing.assert_allclose(CAMERA.project(check.points[best]), pixels1, atol=1e-4)
