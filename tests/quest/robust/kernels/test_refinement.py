"""Compiled refinement: of poses as the readable one, of rotations to the least robust cost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import (
    THRESHOLD_RAD,
    angle_between,
    assert_orthonormal,
    disturbed,
    pose_and_matches,
    random_pose,
    rotated,
)

from quest.geometry.epipolar import sampson_error
from quest.geometry.quaternion import rotation_from_vector
from quest.robust import kernels
from quest.robust.loss import log_likelihoods
from tests.benchmarks.quest.reference import refine_pose

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


@laws
@given(seed=SEEDS, angle_rad=st.floats(0, 0.05), wrong=st.integers(0, 20), iterations=st.integers(0, 12))
def test_refinement_equals_the_readable_refinement(seed, angle_rad, wrong, iterations):
    R, t, m, n = pose_and_matches(seed, wrong=wrong)
    use = np.random.default_rng(seed).random(len(m)) < 0.8
    R0, t0 = disturbed(R, t, seed, angle_rad)
    expected_R, expected_t = refine_pose(R0, t0, m[use], n[use], THRESHOLD_RAD, iterations)
    kernels.refine(m, n, use, R0, t0, THRESHOLD_RAD, iterations)
    # The compiled one ends at a larger gain: within some hundredths of the standard deviation of the pose.
    assert expected_R == pytest.approx(R0, abs=3e-5)
    assert expected_t == pytest.approx(t0, abs=3e-4)


@laws
@given(seed=SEEDS)
def test_refinement_never_raises_the_robust_cost_and_returns_a_pose(seed):
    _, _, m, n = pose_and_matches(seed, wrong=10)
    R, t = random_pose(seed)

    def robust_cost() -> float:
        return -float(log_likelihoods(sampson_error(R, t, m, n), THRESHOLD_RAD).sum())

    before = robust_cost()
    kernels.refine(m, n, np.ones(len(m), bool), R, t, THRESHOLD_RAD, 20)
    assert robust_cost() <= before + 1e-9 * abs(before)
    assert_orthonormal(R)
    assert np.linalg.norm(t) == pytest.approx(1)


@laws
@given(seed=SEEDS, angle_rad=st.floats(0, 0.02), wrong=st.integers(0, 20))
def test_the_refined_rotation_has_the_least_robust_cost(seed, angle_rad, wrong):
    R, m, n = rotated(seed, 60, wrong)
    found, _ = disturbed(R, np.ones(3), seed, angle_rad)
    kernels.refine_rotation(m, n, found, 0.02, 100)
    assert_orthonormal(found)

    def robust_cost(step) -> float:
        r2 = 0.5 * np.sum((n - m @ found.T @ rotation_from_vector(step).T) ** 2, axis=1)
        return float(np.sum(r2 / (0.02**2 + r2)))

    for step in 1e-5 * np.eye(3):
        assert robust_cost(np.zeros(3)) < min(robust_cost(step), robust_cost(-step))


@pytest.mark.parametrize("axis", [[np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi], [0, 0, 0]])
def test_half_turns_and_the_identity_are_refined(axis):
    _, _, m, _ = pose_and_matches(0)
    R = rotation_from_vector(axis)
    found = rotation_from_vector([0.02, -0.03, 0.01]) @ R
    kernels.refine_rotation(m, m @ R.T, found, 0.1, 50)
    assert angle_between(found, R) < 1e-9
