"""Newton's method on five matches: its solutions obey the equations, and it finds the true pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from make_pose_matches import angle_between, assert_orthonormal, disturbed, pose_and_matches
from make_views import unit

from quest.geometry.epipolar import depths_from_pose
from quest.geometry.refine import sampson_jacobian
from quest.robust import kernels

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)
FIVE = np.arange(5)


def constraint(R, t, m, n) -> np.ndarray:
    """``n . (t x R m)``, zero where a match obeys the pose."""
    return np.einsum("ij,ij->i", n, np.cross(t, m @ R.T))


@settings(max_examples=200)
@given(seed=SEEDS, kind=st.sampled_from(["scene", "plane", "random rays", "all around"]))
def test_every_reported_solution_obeys_the_equations(seed, kind):
    rng = np.random.default_rng(seed)
    if kind in ("scene", "plane"):
        _, _, m, n = pose_and_matches(seed, 5, planar=kind == "plane")
    else:
        m, n = (unit(rng.normal((0, 0, 3 * (kind == "random rays")), size=(5, 3))) for _ in range(2))
    for _ in range(10):
        R, t = np.eye(3), unit(rng.normal(size=3))
        if kernels.newton_five(m, n, FIVE, R, t):
            assert np.abs(constraint(R, t, m, n)).max() < 1e-7
            assert min(depth.min() for depth in depths_from_pose(R, t, m, n)) > 0
            assert_orthonormal(R)
            assert np.linalg.det(R) > 0
            assert np.linalg.norm(t) == pytest.approx(1)


@laws
@given(seed=SEEDS, planar=st.booleans(), sign=st.sampled_from([1, -1]))
def test_a_start_near_the_true_pose_reaches_it_for_both_signs_of_t(seed, planar, sign):
    R, t, m, n = pose_and_matches(seed, 5, noise_rad=0.0, planar=planar)
    singular = np.linalg.svd(sampson_jacobian(R, t, m, n)[1], compute_uv=False)
    assume(singular[-1] > 1e-4)  # else five matches hardly fix the pose
    R0, t0 = disturbed(R, t, seed, 0.02 * singular[-1])  # well within the distance to the next root
    t0 *= sign
    assert kernels.newton_five(m, n, FIVE, R0, t0)
    # A root is known to 1e-7 of its equations.
    assert angle_between(R0, R) < 1e-6 / singular[-1]
    assert t0 == pytest.approx(t, abs=1e-6 / singular[-1])


def test_one_start_in_ten_finds_the_true_pose():
    trials, found = 200, 0
    for seed in range(trials):
        truth, t_true, m, n = pose_and_matches(seed, 5, noise_rad=0.0)
        R, t = np.eye(3), unit(np.random.default_rng([seed, 2]).normal(size=3))
        found += kernels.newton_five(m, n, FIVE, R, t) and angle_between(R, truth) < 1e-4 and bool(t @ t_true > 0.999)
    assert found >= trials / 10


@laws
@given(seed=SEEDS, kind=st.sampled_from(["one match", "a match twice", "collinear", "no motion"]))
def test_degenerate_samples_have_no_solution(seed, kind):
    R_true, t_true, m, n = pose_and_matches(seed, 5, noise_rad=0.0)
    if kind == "one match":
        m, n = np.repeat(m[:1], 5, axis=0), np.repeat(n[:1], 5, axis=0)
    elif kind == "a match twice":
        m[4], n[4] = m[0], n[0]
    elif kind == "collinear":
        X = np.array([-1, 0.3, 5]) + np.arange(5)[:, None] * [0.5, 0.2, 0.3]
        m, n = unit(X), unit(X @ R_true.T + t_true)
    else:
        n = m.copy()
    R, t = np.eye(3), unit(np.random.default_rng(seed).normal(size=3))
    assert not kernels.newton_five(m, n, FIVE, R, t)
