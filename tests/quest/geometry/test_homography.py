"""Homographies of planes: the residuals, and the decomposition into the true pose and the second one."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from make_views import unit

from quest.geometry.homography import decompose_homography, homography_residuals
from quest.geometry.quaternion import rotation_angle, rotation_from_vector

SEEDS = st.integers(0, 2**32 - 1)


def plane_views(seed: int, count: int = 40):
    """R, t, k and the bearings of points on the plane k . X = 1 that both cameras see in front."""
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(rng.uniform(-0.3, 0.3, 3))
    t = rng.uniform(-0.8, 0.8, 3)
    k = np.array([*rng.uniform(-0.08, 0.08, 2), 0.25])
    m = unit(rng.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (count, 3)))
    X = m / (m @ k)[:, None]
    return R, t, k, m, unit(X @ R.T + t)


def distances(solutions, R, t, k) -> list[float]:
    return [
        float(rotation_angle(R_i @ R.T)) + float(np.linalg.norm(t_i * np.linalg.norm(k_i) - t * np.linalg.norm(k)))
        for R_i, t_i, k_i in solutions
    ]


@given(seed=SEEDS)
def test_exact_points_of_a_plane_have_no_residuals(seed):
    R, t, k, m, n = plane_views(seed)
    assert np.abs(homography_residuals(R + np.outer(t, k), m, n)).max() < 1e-9


def test_residuals_have_the_size_of_the_noise_of_one_bearing():
    rng = np.random.default_rng(0)
    m = unit(rng.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (4000, 3)))
    n = m @ np.eye(3)
    m, n = (unit(rays + 1e-3 * rng.normal(size=rays.shape)) for rays in (m, n))
    r = homography_residuals(np.eye(3), m, n)
    # Two components of 4000 points: the mean square has a deviation of 1.6 %.
    assert np.sqrt(np.sum(r**2) / (2 * len(m))) == pytest.approx(1e-3, rel=0.05)


@given(seed=SEEDS, scale=st.floats(-5, 5).filter(lambda s: abs(s) > 0.01))
def test_both_poses_explain_the_homography_of_any_scale_and_sign_and_one_is_the_true_one(seed, scale):
    R, t, k, m, _ = plane_views(seed)
    assume(np.linalg.norm(t) > 0.05)
    H = R + np.outer(t, k)
    solutions = decompose_homography(scale * H, m)
    assert len(solutions) == 2
    assert min(distances(solutions, R, t, k)) < 1e-6
    for R_i, t_i, k_i in solutions:
        assert R_i @ R_i.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(R_i) == pytest.approx(1)
        H_i = R_i + np.outer(t_i, k_i)
        assert np.abs(H_i / np.linalg.norm(H_i)) == pytest.approx(np.abs(H / np.linalg.norm(H)), abs=1e-9)
        assert 2 * np.count_nonzero(m @ k_i > 0) >= len(m)


@given(w=st.tuples(*[st.floats(-1.7, 1.7)] * 3), scale=st.sampled_from([1.0, -2.0, 1e-3]))
def test_a_rotation_has_no_decomposition(w, scale):
    m = unit(np.random.default_rng(0).normal(size=(10, 3)))
    assert decompose_homography(scale * rotation_from_vector(w), m) == []
