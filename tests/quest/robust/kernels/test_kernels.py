"""The compiled loops: residuals and scores as the epipolar geometry, refinement as the readable one, the search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import (
    THRESHOLD_RAD,
    angle_between,
    as_model,
    assert_orthonormal,
    costs_of,
    disturbed,
    matches_of_all_kinds,
    pose_and_matches,
    random_pose,
    rotated,
    score,
)
from make_views import unit

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.geometry.quaternion import rotation_from_vector
from quest.robust import kernels
from quest.robust.kernels.samples import SAME_MODE_RAD, mode_distance
from quest.robust.kernels.scoring import rays_by_row, score_or_refute
from quest.robust.loss import log_likelihoods
from quest.robust.pose_problem import PoseProblem
from quest.robust.samples import draw_samples
from tests.benchmarks.quest.reference import refine_pose

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


def expected(R, t, m, n):
    """Squared errors, and which matches lie behind a camera beyond doubt."""
    u, v = depths_from_pose(R, t, m, n)
    observable = np.sum(np.cross(m @ R.T, n) ** 2, axis=1) > 2 * THRESHOLD_RAD**2
    return sampson_error(R, t, m, n) ** 2, observable & ((u < 0) | (v < 0))


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_residuals_and_score_are_those_of_the_epipolar_geometry(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    expected_r2, behind = expected(R, t, m, n)
    r2 = kernels.residuals_of_model(m, n, as_model(R, t), THRESHOLD_RAD)
    assert np.sqrt(r2[~behind]) == pytest.approx(np.sqrt(expected_r2[~behind]), rel=1e-9, abs=1e-12)
    assert (np.isinf(r2) == behind).all()
    # The score is the truncated sum of squares in front of both cameras.
    near = (expected_r2 < THRESHOLD_RAD**2) & ~behind
    cost = np.where(near, expected_r2, THRESHOLD_RAD**2).sum()
    assert score(m, n, R, t, THRESHOLD_RAD, np.inf) == (pytest.approx(cost, rel=1e-9), near.sum())
    problem, model = PoseProblem(m, n, THRESHOLD_RAD), as_model(R, t)
    assert costs_of(problem, model[None]) == pytest.approx([cost], rel=1e-9)
    assert (problem.explained(model, 1e-3) == ((r2 < 1e-6) & ~behind)).all()


@laws
@given(seed=SEEDS, share=st.floats(0, 2))
def test_scoring_stops_early_only_where_the_cost_exceeds_the_bound(seed, share):
    R, t, m, n = matches_of_all_kinds(seed)
    full = score(m, n, R, t, THRESHOLD_RAD, np.inf)
    answer = score(m, n, R, t, THRESHOLD_RAD, share * full[0])
    assert answer == full or (answer == (np.inf, 0) and full[0] > share * full[0])


def test_the_sequential_test_rejects_bad_models_and_almost_no_good_one():
    R, t, m, n = pose_and_matches(0, 300, noise_rad=0.0)
    rng = np.random.default_rng(0)

    def share_given_up(explained: float, trials: int) -> float:
        given_up = 0
        for _ in range(trials):
            wrong = rng.random(len(n)) >= explained
            seen = np.where(wrong[:, None], np.cross(np.cross(t, m @ R.T), n), n)  # across its epipolar line
            cost, _, _ = score_or_refute(rays_by_row(m, unit(seen)), R, t, THRESHOLD_RAD, np.inf, 0.4, 0.1)
            given_up += not np.isfinite(cost)
        return given_up / trials

    # Ville: the likelihood ratio exceeds 100 with probability 0.01 at most; 0.013 is its deviation of 60 trials.
    assert share_given_up(0.4, 600) < 0.01 + 5 * np.sqrt(0.01 / 600)
    assert share_given_up(0.1, 100) > 0.9


# -- compiled refinement: of poses as the readable one, of rotations to the least robust cost ------


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


# -- the compiled search over samples: the pool of modes, its order, and its independence of the order of the data


def searched(m, n, samples, size: int = 8):
    pool = np.zeros((size, 3, 3)), np.zeros((size, 3)), np.full(size, np.inf), np.zeros(size, np.int64)
    kernels.try_samples_of_five(m, n, samples, THRESHOLD_RAD, (*pool, np.zeros(2)))
    return pool


@settings(max_examples=15)
@given(seed=SEEDS, wrong=st.integers(0, 60), size=st.integers(1, 8), planar=st.booleans())
def test_the_pool_holds_distinct_modes_ordered_by_cost(seed, wrong, size, planar):
    _, _, m, n = pose_and_matches(seed, 120, wrong=wrong, planar=planar)
    samples = draw_samples(np.random.default_rng(seed), len(m), 5, 150)
    R, t, costs, inliers = searched(m, n, samples, size)
    filled = np.isfinite(costs)
    assert (costs[:-1] <= costs[1:]).all()
    for i in np.flatnonzero(filled):
        assert score(m, n, R[i], t[i], THRESHOLD_RAD, np.inf) == (costs[i], inliers[i])
        for j in range(i):
            assert mode_distance(R[i], t[i], R[j], t[j]) >= SAME_MODE_RAD


@pytest.mark.parametrize("seed", range(6))
def test_the_best_model_does_not_depend_on_the_order_of_the_matches(seed):
    _, _, m, n = pose_and_matches(seed, 120, wrong=40)
    samples = draw_samples(np.random.default_rng(seed), len(m), 5, 200)
    # Sorted matches would be evaluated by the wrong ones alone, which come first.
    orders = [np.random.default_rng([seed, k]).permutation(len(m)) for k in range(2)]
    first, second = (searched(m[order], n[order], np.argsort(order)[samples]) for order in orders)
    assert second[2][0] == pytest.approx(first[2][0])
    assert second[0][0] == pytest.approx(first[0][0], abs=1e-9)
    assert second[1][0] == pytest.approx(first[1][0], abs=1e-9)
    assert second[3][0] == first[3][0]
