"""The compiled linear algebra equals the readable one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import random_pose
from make_views import unit

from quest.algebra import (
    eigen_in_place,
    solve_in_place,
    turn,
)
from quest.geometry.quaternion import rotation_from_vector

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-300, 1e-9, 0.99e-4, 1.01e-4, 0.1, 3.1]))
def test_turn_is_the_exponential_map_at_all_angles(seed, angle_rad):
    w = angle_rad * unit(np.random.default_rng(seed).normal(size=3))
    R, _ = random_pose(seed)
    expected = rotation_from_vector(w) @ R
    turn(R, *w)
    assert expected == pytest.approx(R, abs=1e-14)


@laws
@given(seed=SEEDS, size=st.integers(1, 6))
def test_elimination_solves_regular_systems(seed, size):
    rng = np.random.default_rng(seed)
    A, x = rng.normal(size=(size, size)), rng.normal(size=size)
    b = A @ x
    condition = np.linalg.cond(A)
    assert solve_in_place(A, b)
    assert b == pytest.approx(x, abs=1e-12 * condition)


def test_elimination_pivots_and_reports_singular_matrices():
    swap, b = np.array([[0.0, 2.0], [4.0, 0.0]]), np.array([2.0, 8.0])
    assert solve_in_place(swap, b)
    assert b.tolist() == [2, 1]
    for singular in (np.zeros((3, 3)), np.ones((3, 3)), np.full((3, 3), np.nan)):
        assert not solve_in_place(singular, np.ones(3))


@laws
@given(seed=SEEDS, size=st.integers(1, 9), rank=st.integers(0, 9), scale=st.sampled_from([1e-12, 1.0, 1e9]))
def test_eigenvectors_equal_those_of_numpy(seed, size, rank, scale):
    J = np.random.default_rng(seed).normal(size=(rank, size))
    A = scale * J.T @ J
    values, V = A.copy(), np.empty((size, size))
    least = eigen_in_place(values, V)
    values = values.diagonal()
    tolerance = 1e-13 * size * max(np.abs(A).max(), 1e-300)
    assert np.sort(values) == pytest.approx(np.linalg.eigvalsh(A), abs=tolerance)
    assert values[least] == values.min()
    assert pytest.approx(np.eye(size), abs=1e-13) == V @ V.T
    assert (V * values) @ V.T == pytest.approx(A, abs=tolerance)
