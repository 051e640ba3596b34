"""The compiled linear algebra equals the readable one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import random_pose
from make_views import unit

from quest.algebra import (
    eigen_in_place,
    median_in_place,
    model_of_pose,
    rotation_of_model,
    solve_in_place,
    tangents,
    turn,
    unit_rows,
)
from quest.geometry.epipolar import as_matches, tangent_basis
from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


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


@laws
@given(seed=SEEDS, count=st.integers(1, 60), different=st.integers(1, 60))
def test_the_median_is_that_of_numpy(seed, count, different):
    values = np.random.default_rng(seed).integers(different, size=count).astype(float)
    expected = np.median(values)
    assert median_in_place(values) == expected


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi]), axis=st.integers(0, 3))
def test_the_model_of_a_pose_holds_its_quaternion(seed, angle_rad, axis):
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(angle_rad * (unit(rng.normal(size=3)) if axis == 3 else np.eye(3)[axis]))
    t = unit(rng.normal(size=3))
    model = model_of_pose(R, t)
    assert np.linalg.norm(model[:4]) == pytest.approx(1, abs=1e-15)
    assert model[:4] == pytest.approx(quaternion_from_matrix(R), abs=1e-14)
    assert (model[4:] == t).all()
    assert rotation_of_model(model) == pytest.approx(matrix_from_quaternion(model[:4]), abs=1e-14)


@laws
@given(seed=SEEDS, scale=st.sampled_from([1e-90, 1e-3, 1.0, 1e90]))
def test_rays_have_unit_norm_or_are_left_to_the_readable_check(seed, scale):
    rays = scale * np.random.default_rng(seed).normal(size=(20, 3))
    found = np.empty_like(rays)
    assert unit_rows(rays, found)
    assert found == pytest.approx(as_matches(rays, rays, 5)[0], abs=1e-15)
    for wrong in (0.0, np.nan, np.inf, 1e200, 1e-200):
        rays[7] = wrong
        assert not unit_rows(rays, found)
