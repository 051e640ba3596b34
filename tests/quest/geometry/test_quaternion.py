"""Laws of rotations as quaternions; rotations near the identity and half turns are among the random cases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quest.geometry.quaternion import (
    canonical,
    conjugate,
    matrix_from_quaternion,
    multiply,
    quaternion_from_matrix,
    rotation_angle,
    rotation_from_vector,
)

SEEDS = st.integers(0, 2**32 - 1)
ANGLES = st.one_of(st.sampled_from([0.0, 1e-12, 1e-8, 1e-4, np.pi - 1e-8, np.pi]), st.floats(0, np.pi, allow_nan=False))


def axis_of(seed: int) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=3)
    return a / np.linalg.norm(a)


def unit(seed: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=4)
    return q / np.linalg.norm(q)


def test_the_matrix_equals_the_sandwich_product():
    # The paper prints four entries with the wrong sign (R13, R23, R31, R32).
    q = unit(0)
    for v in np.eye(3):
        sandwich = multiply(multiply(q, np.r_[0, v]), conjugate(q))
        assert matrix_from_quaternion(q) @ v == pytest.approx(sandwich[1:], abs=1e-15)


@given(SEEDS, SEEDS)
def test_the_product_composes_rotations(a: int, b: int):
    p, q = unit(a), unit(b)
    composed = matrix_from_quaternion(p) @ matrix_from_quaternion(q)
    assert np.allclose(matrix_from_quaternion(multiply(p, q)), composed, atol=1e-14)


@given(SEEDS, ANGLES)
def test_the_quaternion_of_a_matrix_is_the_one_it_came_from(seed: int, angle: float):
    q = canonical(np.r_[np.cos(angle / 2), np.sin(angle / 2) * axis_of(seed)])
    R = matrix_from_quaternion(q)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)
    # At a half turn rounding determines the sign of q.
    back = quaternion_from_matrix(R)
    assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-14


@given(SEEDS, ANGLES)
def test_the_angle_is_accurate_near_zero_and_near_a_half_turn(seed: int, angle: float):
    R = rotation_from_vector(angle * axis_of(seed))
    assert rotation_angle(R) == pytest.approx(angle, abs=1e-15 + 1e-14 * angle + 1e-15)


def test_where_w_is_zero_the_first_non_zero_entry_is_positive():
    assert canonical([0.0, -1.0, 0.0, 0.0]) == pytest.approx([0, 1, 0, 0])
    assert canonical([0.0, 0.0, -0.6, 0.8]) == pytest.approx([0, 0, 0.6, -0.8])
    assert canonical([-0.5, 0.5, 0.5, 0.5])[0] > 0
