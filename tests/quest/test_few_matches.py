"""Few matches and little parallax: what is refused, the kind, the depths, the stated covariance."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, box, is_true, plane, views
from make_views import unit

from quest import RelativePose, estimate_relative_pose
from quest.geometry.epipolar import depths_from_pose, tangent_basis
from quest.geometry.homography import homography_residuals
from quest.geometry.quaternion import rotation_from_vector, vector_from_rotation
from quest.robust import kernels

SEEDS = range(20)


R_SMALL = rotation_from_vector([0.02, -0.05, 0.03])


def simulated(seed: int, count: int, ratio: float, noise_rad: float, points=box):
    """Two views by a camera that moves sideways by a share of the mean depth; the true direction, and all distances."""
    X = points(seed)[:count]
    length = ratio * float(X[:, 2].mean())
    t = length * unit([0.95, 0.25, 0.18])
    m, n = views(X, R_SMALL, t, noise_rad=noise_rad, seed=seed)
    return m, n, t / length, np.linalg.norm(X, axis=1) / length


def nees(pose: RelativePose, t) -> float:
    """Normalized squared error of a pose over its five unknowns; 1 in the mean where the covariance is right."""
    b = tangent_basis(pose.t).T @ t / float(pose.t @ t)
    error = np.concatenate([vector_from_rotation(R_SMALL @ pose.R.T), b])
    return float(error @ np.linalg.solve(pose.covariance, error)) / 5


def test_twenty_right_matches_are_enough():
    poses = [estimate_relative_pose(*views(box(seed)[:20], noise_rad=NOISE_RAD, seed=seed)) for seed in SEEDS]
    assert all(pose and is_true(pose, rotation_deg=5, direction_deg=15) for pose in poses)


@pytest.mark.parametrize("count", [10, 16, 30])
def test_a_camera_that_only_rotates_shows_no_translation_by_few_matches(count):
    for seed in SEEDS:
        pose = estimate_relative_pose(*views(box(seed)[:count], t=NO_TRANSLATION, noise_rad=NOISE_RAD, seed=seed))
        assert not pose or pose.kind == "rotation"


@pytest.mark.parametrize(("kind", "points", "ratio", "most"), [("general", box, 0.05, 19), ("planar", plane, 0.15, 17)])
def test_thirty_matches_show_whether_the_scene_is_a_plane(kind, points, ratio, most):
    pairs = [simulated(seed, 30, ratio, 5e-4, points)[:2] for seed in SEEDS]
    assert [estimate_relative_pose(*pair).kind for pair in pairs].count(kind) >= most


def test_depths_at_low_parallax_are_not_biased_although_those_of_the_midpoint_are():
    """Parallax of twice the noise: the noise across the epipolar lines widens the angle between the rays."""
    ratios, midpoints = [], []
    for seed in SEEDS:
        m, n, t, distances = simulated(seed, 200, 0.01, 3e-3)
        inliers = np.ones(len(m), bool)
        ratios.extend(kernels.depths_and_parallax(m, n, R_SMALL, t, inliers)[0][0] / distances)
        midpoints.extend(depths_from_pose(R_SMALL, t, m, n)[0] / distances)
    # In the median over all points, with those behind the camera beyond infinity.
    inverse, inverse_midpoint = (np.median(1 / np.array(values)) for values in (ratios, midpoints))
    assert inverse == pytest.approx(1, abs=0.05)
    assert inverse_midpoint > 1.15


@pytest.mark.parametrize("points", [box, plane], ids=["general", "planar"])
@pytest.mark.parametrize("count", [30, 200])
def test_the_covariance_states_the_error(points, count):
    """The median of chi-square with five degrees of freedom is 0.87 of its mean."""
    errors = []
    for seed in range(40):
        m, n, t, _ = simulated(seed, count, 0.15, NOISE_RAD, points)
        pose = estimate_relative_pose(m, n, threshold_rad=3 * NOISE_RAD)
        # On a plane the better one of the two motions may be the wrong one.
        if pose and np.degrees(np.arccos(min(1.0, pose.t @ t))) < 5:
            errors.append(nees(pose, t))
    assert len(errors) >= 20
    assert 0.5 < np.median(errors) < 1.6


def test_the_covariance_of_a_planar_pose_is_that_of_numerical_derivatives():
    pair = simulated(3, 120, 0.15, 2e-4, plane)[:2]
    pose = estimate_relative_pose(*pair)
    assert pose.kind == "planar"
    (m, n), basis = (rays[pose.inliers] for rays in pair), tangent_basis(pose.t)
    a, across = m @ pose.R.T, np.cross(n, pose.t)
    k = np.linalg.lstsq((across[:, :, None] * m[:, None, :]).reshape(-1, 3), -np.cross(n, a).reshape(-1), rcond=None)[0]

    def residuals(x):
        t = pose.t + basis @ x[3:5]
        H = rotation_from_vector(x[:3]) @ pose.R + np.outer(t / np.linalg.norm(t), k + x[5:])
        return homography_residuals(H, m, n).reshape(-1)

    steps = 1e-5 * np.eye(8)
    J = np.stack([(residuals(step) - residuals(-step)) / 2e-5 for step in steps], axis=1)
    shape = np.linalg.inv(J.T @ J)[:5, :5]
    # The factor is the variance of a residual, the same for all entries.
    factor = np.trace(pose.covariance) / np.trace(shape)
    assert np.sqrt(factor) == pytest.approx(pose.noise_rad, rel=0.2)
    np.testing.assert_allclose(pose.covariance, factor * shape, atol=0.02 * np.abs(pose.covariance).max())
