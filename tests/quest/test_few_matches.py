"""Few matches and little parallax: what is refused, the kind, the depths, the stated covariance."""

from dataclasses import dataclass

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, box, is_true, plane, views

from quest import RelativePose, estimate_relative_pose
from quest.geometry.epipolar import depths_from_pose, tangent_basis
from quest.geometry.homography import homography_residuals
from quest.geometry.quaternion import rotation_from_vector
from quest.robust import kernels

SEEDS = range(20)


@dataclass(frozen=True)
class Simulated:
    """A simulated pair: its matches and its true motion."""

    m: np.ndarray
    n: np.ndarray
    R: np.ndarray
    t: np.ndarray
    distances: np.ndarray


def simulated(seed: int, *, count: int, ratio: float, noise_rad: float, points=None) -> Simulated:
    """Points in a box or as given, seen by a camera that moves sideways by a share of the mean depth."""
    rng = np.random.default_rng(seed)
    X = box(seed)[:count] if points is None else points[:count]
    R = rotation_from_vector(np.array([0.02, -0.05, 0.03]))
    length = ratio * float(X[:, 2].mean())
    t = length * np.array([0.95, 0.25, 0.18]) / np.linalg.norm([0.95, 0.25, 0.18])
    m, n = (Y / np.linalg.norm(Y, axis=1, keepdims=True) for Y in (X, X @ R.T + t))
    m, n = (Y + noise_rad * rng.normal(size=Y.shape) for Y in (m, n))
    unit = [Y / np.linalg.norm(Y, axis=1, keepdims=True) for Y in (m, n)]
    return Simulated(unit[0], unit[1], R, t / length, np.linalg.norm(X, axis=1) / length)


def nees(pose: RelativePose, truth: Simulated) -> float:
    """Normalized squared error of a pose over its five unknowns; 1 in the mean where the covariance is right."""
    turned = truth.R @ pose.R.T
    w = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    b = tangent_basis(pose.t).T @ truth.t / float(pose.t @ truth.t)
    error = np.concatenate([w, b])
    return float(error @ np.linalg.solve(pose.covariance, error)) / 5


def test_twenty_right_matches_are_enough():
    poses = [estimate_relative_pose(*views(box(seed)[:20], noise_rad=NOISE_RAD, seed=seed)) for seed in SEEDS]
    assert all(pose and is_true(pose, rotation_deg=5, direction_deg=15) for pose in poses)


@pytest.mark.parametrize("count", [10, 16, 30])
def test_a_camera_that_only_rotates_shows_no_translation_by_few_matches(count):
    for seed in SEEDS:
        pose = estimate_relative_pose(*views(box(seed)[:count], t=NO_TRANSLATION, noise_rad=NOISE_RAD, seed=seed))
        assert not pose or pose.kind == "rotation"


def test_thirty_matches_of_a_general_scene_are_no_plane():
    kinds = [
        estimate_relative_pose(pair.m, pair.n).kind
        for pair in (simulated(seed, count=30, ratio=0.05, noise_rad=5e-4) for seed in SEEDS)
    ]
    assert kinds.count("general") >= 19


def test_thirty_matches_of_a_plane_are_a_plane():
    kinds = [
        estimate_relative_pose(pair.m, pair.n).kind
        for pair in (simulated(seed, count=30, ratio=0.15, noise_rad=5e-4, points=plane(seed)) for seed in SEEDS)
    ]
    assert kinds.count("planar") >= 17


def depths_of(pair: Simulated) -> np.ndarray:
    """The depths (2, N) of all matches in both views."""
    inliers = np.ones(len(pair.m), bool)
    return kernels.depths_and_parallax(pair.m, pair.n, pair.R, pair.t, inliers)[0]


def test_depths_at_low_parallax_are_not_biased_although_those_of_the_midpoint_are():
    """Parallax of twice the noise: the noise across the epipolar lines widens the angle between the rays."""
    ratios, midpoints = [], []
    for seed in SEEDS:
        pair = simulated(seed, count=200, ratio=0.01, noise_rad=3e-3)
        ratios.extend(depths_of(pair)[0] / pair.distances)
        midpoints.extend(depths_from_pose(pair.R, pair.t, pair.m, pair.n)[0] / pair.distances)
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
        pair = simulated(seed, count=count, ratio=0.15, noise_rad=NOISE_RAD, points=points(seed))
        pose = estimate_relative_pose(pair.m, pair.n, threshold_rad=3 * NOISE_RAD)
        # On a plane the better one of the two motions may be the wrong one.
        if pose and np.degrees(np.arccos(min(1.0, pose.t @ pair.t))) < 5:
            errors.append(nees(pose, pair))
    assert len(errors) >= 20
    assert 0.5 < np.median(errors) < 1.6


def test_the_covariance_of_a_planar_pose_is_that_of_numerical_derivatives():
    pair = simulated(3, count=120, ratio=0.15, noise_rad=2e-4, points=plane(3))
    pose = estimate_relative_pose(pair.m, pair.n)
    assert pose.kind == "planar"
    m, n, basis = pair.m[pose.inliers], pair.n[pose.inliers], tangent_basis(pose.t)
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
