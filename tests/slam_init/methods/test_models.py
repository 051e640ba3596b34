"""Fundamental matrices, homographies and the motions behind them: exact on exact data."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.benchmarks.two_view_scenes import CAMERA
from slam_init.methods.models import (
    epipolar_errors,
    fundamental_eight_point,
    homography_dlt,
    normalize,
    normalizing_transform,
    sampson_errors,
    transfer_errors,
)
from slam_init.methods.motions import CheckRule, check_motions, motions_of_essential, motions_of_homography
from slam_init.types.pose import Pose

RULE = CheckRule(max_error_px=1e-3, distant_cos=1.0)


def views(seed, count=60, planar=False):
    """Exact pixels of points seen twice, and cam2_from_cam1 with |t| = 1."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -1.5, 4], [2, 1.5, 8], (count, 3))
    if planar:
        points[:, 2] = 6 + 0.4 * points[:, 0] - 0.3 * points[:, 1]
    t = rng.normal(size=3)
    pose = Pose(rotation_from_vector(0.1 * rng.normal(size=3)), t / np.linalg.norm(t))
    # Ideal pixels: whether they lie on the sensor does not matter here.
    return CAMERA.project(points), CAMERA.project(pose.apply(points)), pose


def estimate(solver, pixels1, pixels2, back):
    T1, T2 = normalizing_transform(pixels1), normalizing_transform(pixels2)
    model = solver(normalize(T1, pixels1)[None], normalize(T2, pixels2)[None])
    return (T2.T if back == "transpose" else np.linalg.inv(T2)) @ model @ T1


def contains(R, t, pose):
    """Whether one of the motions is the pose."""
    near = [rotation_angle(a.T @ pose.R) < 1e-5 and a_t @ pose.t > 1 - 1e-9 for a, a_t in zip(R, t, strict=True)]
    return sum(near) == 1


@given(st.integers(0, 10_000), st.integers(8, 30))
def test_a_fundamental_matrix_fits_exact_matches_and_holds_the_motion(seed, count):
    pixels1, pixels2, pose = views(seed, count)
    F = estimate(fundamental_eight_point, pixels1, pixels2, "transpose")
    assert max(e.max() for e in epipolar_errors(F, pixels1, pixels2)) < 1e-6
    assert sampson_errors(F, pixels1, pixels2).max() < 1e-6
    assert abs(np.linalg.det(F[0] / np.linalg.norm(F[0]))) < 1e-12
    if count >= 12:  # eight points can lie near a critical surface
        R, t = motions_of_essential(CAMERA.K.T @ F[0] @ CAMERA.K)
        np.testing.assert_allclose(np.linalg.det(R), 1)
        assert contains(R, t, pose)


@given(st.integers(0, 10_000), st.integers(4, 30))
def test_a_homography_fits_an_exact_plane(seed, count):
    pixels1, pixels2, _ = views(seed, count, planar=True)
    H = estimate(homography_dlt, pixels1, pixels2, "inverse")
    assert max(e.max() for e in transfer_errors(H, pixels1, pixels2)) < 1e-4


@given(st.integers(0, 10_000))
def test_the_motions_of_a_plane_hold_the_true_one(seed):
    pixels1, pixels2, pose = views(seed, planar=True)
    H = estimate(homography_dlt, pixels1, pixels2, "inverse")[0]
    R, t, normals = motions_of_homography(np.linalg.inv(CAMERA.K) @ H @ CAMERA.K, 1.0)
    assert R.shape == (8, 3, 3)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-9)
    assert contains(R, t, pose)
    true_normal = np.array([-0.4, 0.3, 1]) / np.linalg.norm([-0.4, 0.3, 1])
    assert np.abs(normals @ true_normal).max() > 1 - 1e-6


def test_a_rotation_has_no_motion_of_a_plane():
    R, t, normals = motions_of_homography(rotation_from_vector(np.array([0.1, 0.2, -0.05])), 1.00001)
    assert len(R) == len(t) == len(normals) == 0


@pytest.mark.parametrize("midpoint", [False, True])
def test_only_the_true_motion_puts_all_points_in_front(midpoint):
    pixels1, pixels2, pose = views(3)
    rays1, rays2 = CAMERA.bearings(pixels1), CAMERA.bearings(pixels2)
    F = estimate(fundamental_eight_point, pixels1, pixels2, "transpose")[0]
    R, t = motions_of_essential(CAMERA.K.T @ F @ CAMERA.K)
    rule = CheckRule(max_error_px=1e-3, distant_cos=1.0, midpoint=midpoint)
    check = check_motions(CAMERA, R, t, rays1, rays2, np.ones(60, bool), rule)
    counts = check.good.sum(axis=1)
    assert sorted(counts)[-1] == 60
    assert sorted(counts)[-2] < 60
    best = int(np.argmax(counts))
    np.testing.assert_allclose(check.pose(best).R, pose.R, atol=1e-6)
    np.testing.assert_allclose(CAMERA.project(check.points[best]), pixels1, atol=1e-4)


def test_what_is_no_inlier_is_not_looked_at():
    pixels1, pixels2, pose = views(4)
    rays = CAMERA.bearings(pixels1), CAMERA.bearings(pixels2)
    inliers = np.arange(60) < 20
    check = check_motions(CAMERA, pose.R[None], pose.t[None], *rays, inliers, RULE)
    assert (check.good[0] == inliers).all()
    assert np.isnan(check.points[0][~inliers]).all()
    none = check_motions(CAMERA, pose.R[None], pose.t[None], *rays, np.zeros(60, bool), RULE)
    assert none.parallax_deg[0] == 0
    assert not none.good.any()


def test_a_point_at_infinity_is_no_landmark():
    pixels1, _, pose = views(5)
    rays = CAMERA.bearings(pixels1)
    turned = rays @ pose.R.T
    before = turned[:, 2] > 0.1
    rule = CheckRule(max_error_px=2.0, distant_cos=0.99998)
    check = check_motions(
        CAMERA, pose.R[None], pose.t[None], rays[before], turned[before], np.ones(before.sum(), bool), rule
    )
    assert not check.landmarks.any()


def test_the_ranked_parallax_is_the_largest_but_so_many():
    pixels1, pixels2, pose = views(6)
    rays1, rays2 = CAMERA.bearings(pixels1), CAMERA.bearings(pixels2)
    angles = np.degrees(np.arccos(np.einsum("ij,ij->i", rays1 @ pose.R.T, rays2)))
    for ranked, expected in ((0, angles.max()), (9, np.sort(angles)[-10]), (1000, angles.min())):
        rule = CheckRule(max_error_px=1e-3, distant_cos=1.0, ranked=ranked)
        check = check_motions(CAMERA, pose.R[None], pose.t[None], rays1, rays2, np.ones(60, bool), rule)
        assert check.parallax_deg[0] == pytest.approx(expected, abs=1e-6)
