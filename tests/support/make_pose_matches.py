"""Poses and matched bearings for tests of robust estimation: noise, outliers, points behind a camera."""

import numpy as np
from make_two_views import NOISE_RAD, box, plane, views
from make_views import unit

from quest.geometry.quaternion import quaternion_from_matrix, rotation_angle, rotation_from_vector
from quest.robust.kernels.scoring import rays_by_row, score_or_refute

#: Sampson error above which a match is an outlier.
THRESHOLD_RAD = 2e-3


def pose_and_matches(seed: int, count: int = 60, *, noise_rad: float = NOISE_RAD, wrong: int = 0, planar: bool = False):
    """R, t of a motion by up to 0.5 rad, and bearings m, n of points in front of both cameras.

    The first ``wrong`` matches are outliers.
    """
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(rng.uniform(-0.3, 0.3, 3))
    t = unit(rng.normal(size=3))
    X = (plane if planar else box)(seed, count)
    return R, t, *views(X, R, t, noise_rad=noise_rad, outliers=wrong / count, seed=seed)


def rotated(seed: int, count: int, wrong: int):
    """R, and bearings m, n = R m of a camera that only rotates, with noise; the first ones are outliers."""
    R, _, m, _ = pose_and_matches(seed, count)
    return R, m, views(m, R, np.zeros(3), noise_rad=NOISE_RAD, outliers=wrong / count, seed=seed)[1]


def matches_of_all_kinds(seed: int):
    """R, t and 80 matches: inliers, outliers, points behind both cameras or one of them, points at infinity."""
    R, t, m, n = pose_and_matches(seed, 80, wrong=20)
    m[20:30], n[20:30] = -m[20:30], -n[20:30]
    n[30:35] = -n[30:35]
    n[35:50] = m[35:50] @ R.T
    return R, t, m, n


def disturbed(R, t, seed: int, angle_rad: float):
    """The pose with a rotation by the angle, and a change of the direction of about the same size."""
    rng = np.random.default_rng([seed, 1])
    R, t = rotation_from_vector(angle_rad * unit(rng.normal(size=3))) @ R, unit(t + angle_rad * rng.normal(size=3))
    return np.ascontiguousarray(R), t


def random_pose(seed: int):
    """Any R, t with |t| = 1."""
    return disturbed(rotation_from_vector(np.random.default_rng(seed).uniform(-1.5, 1.5, 3)), np.zeros(3), seed, 1.0)


def as_model(R, t) -> np.ndarray:
    """The pose as a row (q_wxyz, t)."""
    return np.concatenate([quaternion_from_matrix(R), t])


def angle_between(R1, R2) -> float:
    """Angle between two rotations, radians."""
    return float(rotation_angle(R1 @ R2.T))


def assert_orthonormal(R) -> None:
    """R is orthonormal to rounding."""
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12


def score(m, n, R, t, threshold_rad, bail):
    """Truncated cost and number of inliers of a pose."""
    return score_or_refute(rays_by_row(m, n), R, t, threshold_rad, bail, 0.0, 0.0)[:2]


def costs_of(problem, models):
    """Truncated costs (H,) of models (H, 7)."""
    r2 = np.array([problem.residuals(model) for model in models])
    return np.minimum(r2, problem.threshold_rad**2).sum(axis=1)
