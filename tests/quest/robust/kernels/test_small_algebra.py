"""The compiled linear algebra equals the readable one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import random_pose
from make_views import unit

from quest.geometry.quaternion import rotation_from_vector
from quest.geometry.refine import tangent_basis
from quest.robust.kernels.small_algebra import solve_in_place, tangents, turn

SEEDS = st.integers(0, 2**32 - 1)
#: The first call compiles, so there is no deadline.
laws = settings(deadline=None, max_examples=40)


@laws
@given(seed=SEEDS)
def test_the_tangents_are_the_tangent_basis(seed):
    t = unit(np.random.default_rng(seed).normal(size=3))
    first, second = tangent_basis(t).T
    x, y, z, u, v, w = tangents(t)
    assert [x, y, z] == pytest.approx(first, abs=1e-12)
    assert [u, v, w] == pytest.approx(second, abs=1e-12)


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
