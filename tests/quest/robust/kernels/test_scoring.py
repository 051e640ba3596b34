"""Residuals and scores are those of the epipolar geometry; the early stop changes no decision."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import (
    THRESHOLD_RAD,
    as_model,
    costs_of,
    disturbed,
    matches_of_all_kinds,
    pose_and_matches,
    score,
)
from make_views import unit

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.robust import kernels
from quest.robust.kernels.scoring import rays_by_row, score_or_refute
from quest.robust.pose_problem import PoseProblem

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


def expected(R, t, m, n):
    """Squared errors, and which matches lie behind a camera beyond doubt."""
    u, v = depths_from_pose(R, t, m, n)
    observable = np.sum(np.cross(m @ R.T, n) ** 2, axis=1) > 2 * THRESHOLD_RAD**2
    return sampson_error(R, t, m, n) ** 2, observable & ((u < 0) | (v < 0))


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_residuals_are_those_of_the_epipolar_geometry(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    expected_r2, behind = expected(R, t, m, n)
    r2 = kernels.residuals_of_model(m, n, as_model(R, t), THRESHOLD_RAD)
    assert np.sqrt(r2[~behind]) == pytest.approx(np.sqrt(expected_r2[~behind]), rel=1e-9, abs=1e-12)
    assert (np.isinf(r2) == behind).all()


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_the_score_is_the_truncated_sum_of_squares_in_front_of_both_cameras(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    r2, behind = expected(R, t, m, n)
    near = (r2 < THRESHOLD_RAD**2) & ~behind
    cost = np.where(near, r2, THRESHOLD_RAD**2).sum()
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
