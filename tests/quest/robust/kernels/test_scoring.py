"""Compiled residuals and scores equal the readable ones; the early stop changes no decision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import THRESHOLD_RAD, as_model, disturbed, matches_of_all_kinds, pose_and_matches
from make_views import unit
from reference_ransac import RelativePoseProblem

from quest.geometry.quaternion import matrix_from_quaternion
from quest.robust import kernels
from quest.robust.kernels.scoring import rays_by_row, score_or_refute
from quest.robust.pose_problem import PoseProblem

SEEDS = st.integers(0, 2**32 - 1)
#: The first call compiles, so there is no deadline.
laws = settings(deadline=None, max_examples=40)


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_residuals_equal_those_of_the_readable_problem(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    (expected,), (expected_behind,) = RelativePoseProblem(m, n, THRESHOLD_RAD).residuals(as_model(R, t)[None])
    r2, behind = kernels.residuals(m, n, R, t, THRESHOLD_RAD)
    assert np.sqrt(r2) == pytest.approx(np.sqrt(expected), rel=1e-9, abs=1e-12)
    assert (behind == expected_behind).all()
    r2_of_model, behind_of_model = kernels.residuals_of_model(m, n, as_model(R, t), THRESHOLD_RAD)
    assert np.sqrt(r2_of_model) == pytest.approx(np.sqrt(r2), rel=1e-9, abs=1e-12)
    assert (behind_of_model == behind).all()


def test_a_match_on_both_epipoles_has_a_residual_of_zero():
    t = np.array([0.0, 0.0, 1.0])
    r2, behind = kernels.residuals(t[None], t[None], np.eye(3), t, THRESHOLD_RAD)
    assert (r2.tolist(), behind.tolist()) == ([0.0], [False])


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_the_score_equals_the_cost_of_the_readable_problem(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    (expected,), (expected_inliers,) = RelativePoseProblem(m, n, THRESHOLD_RAD).costs(as_model(R, t)[None])
    cost, inliers = kernels.score(m, n, R, t, THRESHOLD_RAD, np.inf)
    assert cost == pytest.approx(expected, rel=1e-9)
    assert inliers == expected_inliers


@laws
@given(seed=SEEDS, share=st.floats(0, 2))
def test_scoring_stops_early_only_where_the_cost_exceeds_the_bound(seed, share):
    R, t, m, n = matches_of_all_kinds(seed)
    full = kernels.score(m, n, R, t, THRESHOLD_RAD, np.inf)
    answer = kernels.score(m, n, R, t, THRESHOLD_RAD, share * full[0])
    assert answer == full or (answer == (np.inf, 0) and full[0] > share * full[0])


@laws
@given(seed=SEEDS)
def test_the_early_stop_does_not_change_the_best_pose(seed):
    R, t, m, n = matches_of_all_kinds(seed)
    poses = [disturbed(R, t, seed + k, angle_rad) for k, angle_rad in enumerate([0.5, 0.02, 1e-3, 0.1, 1e-3, 2.0])]
    best, winner = np.inf, -1
    for k, pose in enumerate(poses):
        cost, _ = kernels.score(m, n, *pose, THRESHOLD_RAD, best)
        if cost < best:
            best, winner = cost, k
    costs = [kernels.score(m, n, *pose, THRESHOLD_RAD, np.inf)[0] for pose in poses]
    assert winner == np.argmin(costs)


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


@laws
@given(seed=SEEDS)
def test_the_compiled_problem_equals_the_readable_one(seed):
    R, t, m, n = matches_of_all_kinds(seed)
    readable, compiled = RelativePoseProblem(m, n, THRESHOLD_RAD), PoseProblem(m, n, THRESHOLD_RAD)
    models = np.stack([as_model(*disturbed(R, t, seed, angle_rad)) for angle_rad in (0.0, 1e-3, 0.1)])
    for ours, theirs in zip(compiled.costs(models), readable.costs(models), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9)
    assert (compiled.explained(models[1], 1e-3) == readable.explained(models[1], 1e-3)).all()
    use = readable.explained(models[1], 2 * THRESHOLD_RAD)
    ours, theirs = (one.refine(models[1], use, 0.5 * THRESHOLD_RAD) for one in (compiled, readable))
    assert matrix_from_quaternion(ours[:4]) == pytest.approx(matrix_from_quaternion(theirs[:4]), abs=1e-6)
    assert ours[4:] == pytest.approx(theirs[4:], abs=1e-5)
