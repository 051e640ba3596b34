"""Refinement of poses and rotations: the Jacobian, descent, exact data, and the invariances of the problem."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_views import unit

from quest.geometry.epipolar import sampson_error, tangent_basis
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from quest.robust.rotation import refine_rotation
from tests.benchmarks.quest.reference import refine_pose, sampson_jacobian

SEEDS = st.integers(0, 2**32 - 1)
SCALE_RAD = 1e-3


def two_views(seed: int, count: int = 60, noise_rad: float = 0.0):
    """A motion by up to 0.5 rad, points in front of camera 1, and their noisy bearings in both views."""
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(rng.uniform(-0.3, 0.3, 3))
    t = unit(rng.normal(size=3))
    X = rng.uniform([-2, -2, 4], [2, 2, 8], (count, 3))
    m, n = unit(X), unit(X @ R.T + t)
    m, n = (unit(rays + noise_rad * rng.normal(size=rays.shape)) for rays in (m, n))
    return R, t, m, n


def disturbed(R, t, seed: int, angle_rad: float):
    rng = np.random.default_rng(seed)
    return rotation_from_vector(angle_rad * unit(rng.normal(size=3))) @ R, unit(t + angle_rad * rng.normal(size=3))


def robust_cost(R, t, m, n, scale_rad: float) -> float:
    r2 = sampson_error(R, t, m, n) ** 2
    return float(np.sum(r2 / (scale_rad**2 + r2)))


def rotation_distance(R1, R2) -> float:
    return float(rotation_angle(R1 @ R2.T))


@given(seed=SEEDS, shape=st.sampled_from([(3,), (5, 3), (2, 4, 3)]))
def test_the_basis_is_orthonormal_and_orthogonal_to_its_vector(seed, shape):
    t = np.random.default_rng(seed).normal(size=shape)
    B = tangent_basis(t)
    assert B.shape == (*shape, 2)
    assert np.swapaxes(B, -1, -2) @ B == pytest.approx(np.broadcast_to(np.eye(2), (*shape[:-1], 2, 2)), abs=1e-12)
    assert np.einsum("...ij,...i->...j", B, t) == pytest.approx(np.zeros((*shape[:-1], 2)), abs=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_basis_of_an_axis_is_orthogonal_to_it(axis):
    assert np.abs(tangent_basis(np.eye(3)[axis]))[axis] == pytest.approx([0, 0])


@settings(max_examples=50)
@given(seed=SEEDS)
def test_the_errors_equal_those_of_the_epipolar_geometry(seed):
    R, t, m, n = two_views(seed, noise_rad=0.05)
    r, _ = sampson_jacobian(R, t, m, n)
    assert r == pytest.approx(sampson_error(R, t, m, n), abs=1e-12)


@settings(max_examples=50)
@given(seed=SEEDS)
def test_the_jacobian_equals_finite_differences(seed):
    R, t, m, n = two_views(seed, noise_rad=0.05)
    _, J = sampson_jacobian(R, t, m, n)
    B, h = tangent_basis(t), 1e-6

    def moved(step):
        return sampson_jacobian(rotation_from_vector(step[:3]) @ R, unit(t + B @ step[3:]), m, n)[0]

    differences = [(moved(step) - moved(-step)) / (2 * h) for step in h * np.eye(5)]
    # Near an epipole the residual is not linear within the step.
    away = (np.abs(m @ R.T @ t) < 0.99) & (np.abs(n @ t) < 0.99)
    assert J[away] == pytest.approx(np.column_stack(differences)[away], abs=1e-6)


def test_a_match_on_both_epipoles_has_residual_zero_and_finite_derivatives():
    t = np.array([[0.0, 0.0, 1.0]])
    r, J = sampson_jacobian(np.eye(3), t[0], t, t)
    assert r.tolist() == [0]
    assert np.isfinite(J).all()


@settings(max_examples=50)
@given(seed=SEEDS, angle_rad=st.floats(1e-4, 0.5), outliers=st.integers(0, 30))
def test_refinement_never_raises_the_robust_cost(seed, angle_rad, outliers):
    R, t, m, n = two_views(seed, noise_rad=5e-4)
    n[:outliers] = unit(np.random.default_rng(seed).normal(size=(outliers, 3)))
    start = disturbed(R, t, seed, angle_rad)
    R_end, t_end = refine_pose(*start, m, n, SCALE_RAD)
    before, after = robust_cost(*start, m, n, SCALE_RAD), robust_cost(R_end, t_end, m, n, SCALE_RAD)
    assert after <= before * (1 + 1e-9)
    assert np.linalg.norm(t_end) == pytest.approx(1)
    assert R_end @ R_end.T == pytest.approx(np.eye(3), abs=1e-12)


@settings(max_examples=50)
@given(seed=SEEDS)
def test_exact_matches_give_the_true_pose(seed):
    R, t, m, n = two_views(seed)
    R_end, t_end = refine_pose(*disturbed(R, t, seed, 0.01), m, n, 0.05, iterations=30)
    assert rotation_distance(R_end, R) < 1e-8
    assert t_end == pytest.approx(t, abs=1e-7)


def test_gross_outliers_have_no_influence():
    R, t, m, n = two_views(3, count=200)
    n[:60] = unit(np.random.default_rng(0).uniform([-0.4, -0.4, 1], [0.4, 0.4, 1], (60, 3)))
    R_end, t_end = refine_pose(*disturbed(R, t, 1, 0.005), m, n, SCALE_RAD, iterations=30)
    assert rotation_distance(R_end, R) < 1e-4
    assert t_end == pytest.approx(t, abs=1e-3)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_turning_the_second_camera_turns_the_result(seed):
    R, t, m, n = two_views(seed, noise_rad=5e-4)
    Q = rotation_from_vector(np.random.default_rng(seed).uniform(-3, 3, 3))
    R0, t0 = disturbed(R, t, seed, 0.01)
    R1, t1 = refine_pose(R0, t0, m, n, SCALE_RAD, iterations=40)
    R2, t2 = refine_pose(Q @ R0, Q @ t0, m, n @ Q.T, SCALE_RAD, iterations=40)
    assert rotation_distance(R2, Q @ R1) < 1e-4
    assert t2 == pytest.approx(Q @ t1, abs=1e-3)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_swapping_the_views_inverts_the_refined_pose(seed):
    R, t, m, n = two_views(seed, noise_rad=5e-4)
    R0, t0 = disturbed(R, t, seed, 0.01)
    R1, t1 = refine_pose(R0, t0, m, n, SCALE_RAD, iterations=40)
    R2, t2 = refine_pose(R0.T, -R0.T @ t0, n, m, SCALE_RAD, iterations=40)
    assert rotation_distance(R2, R1.T) < 1e-4
    assert t2 == pytest.approx(-R1.T @ t1, abs=1e-3)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_the_order_of_matches_and_the_sign_of_rays_change_nothing(seed):
    R, t, m, n = two_views(seed, noise_rad=5e-4)
    R0, t0 = disturbed(R, t, seed, 0.01)
    order = np.random.default_rng(seed).permutation(len(m))
    R1, t1 = refine_pose(R0, t0, m, n, SCALE_RAD)
    R2, t2 = refine_pose(R0, t0, -m[order], n[order], SCALE_RAD)
    assert rotation_distance(R2, R1) < 1e-7
    assert t2 == pytest.approx(t1, abs=1e-6)


def test_refinement_without_matches_changes_nothing():
    R, t, m, n = two_views(0)
    R_end, t_end = refine_pose(R, t, m[:0], n[:0], SCALE_RAD)
    assert R_end.tolist() == R.tolist()
    assert t_end.tolist() == t.tolist()


@settings(max_examples=50)
@given(seed=SEEDS)
def test_the_rotation_of_exact_data_is_found_among_outliers(seed):
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(rng.uniform(-1.5, 1.5, 3))
    m = unit(rng.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (100, 3)))
    n = m @ R.T
    n[:30] = unit(rng.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (30, 3))) @ R.T
    start = rotation_from_vector(2e-3 * unit(rng.normal(size=3))) @ R
    found = refine_rotation(start, m, n, 2e-3, iterations=50)
    # The weight falls with the fourth power of the residual; outliers near their true place keep a small weight.
    assert rotation_distance(found, R) < 2e-4
    assert np.linalg.det(found) == pytest.approx(1)


def test_a_half_turn_is_refined():
    m = unit(np.random.default_rng(0).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (50, 3)))
    R = np.diag([1.0, -1.0, -1.0])
    assert refine_rotation(rotation_from_vector([3.1, 0, 0]), m, m @ R.T, 0.1, iterations=50) == pytest.approx(
        R, abs=1e-9
    )
