"""The readable refinement that the compiled one is compared with: its derivatives, and exact data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import angle_between, disturbed, pose_and_matches
from make_views import unit

from quest.geometry.epipolar import sampson_error, tangent_basis
from quest.geometry.quaternion import rotation_from_vector
from tests.benchmarks.quest.reference import refine_pose, sampson_jacobian

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=50)
@given(seed=SEEDS)
def test_the_errors_equal_those_of_the_epipolar_geometry(seed):
    R, t, m, n = pose_and_matches(seed, noise_rad=0.05)
    r, _ = sampson_jacobian(R, t, m, n)
    assert r == pytest.approx(sampson_error(R, t, m, n), abs=1e-12)


@settings(max_examples=50)
@given(seed=SEEDS)
def test_the_jacobian_equals_finite_differences(seed):
    R, t, m, n = pose_and_matches(seed, noise_rad=0.05)
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
@given(seed=SEEDS)
def test_exact_matches_give_the_true_pose(seed):
    R, t, m, n = pose_and_matches(seed, noise_rad=0.0)
    R_end, t_end = refine_pose(*disturbed(R, t, seed, 0.01), m, n, 0.05, iterations=30)
    assert angle_between(R_end, R) < 1e-8
    assert t_end == pytest.approx(t, abs=1e-7)
