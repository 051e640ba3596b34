"""Compiled local optimization: subsets, refinement in stages, refits."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import THRESHOLD_RAD, as_model, costs_of, disturbed, pose_and_matches, score

from quest.robust import kernels
from quest.robust.kernels.local_optimization import draw_subset
from quest.robust.pose_problem import PoseProblem

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


def test_all_subsets_are_drawn_equally_often():
    rng, subset = np.random.default_rng(0), np.empty(3, np.int64)
    counts = dict.fromkeys(combinations(range(6), 3), 0)
    for uniform in rng.random((10_000, 3)):
        draw_subset(uniform, 6, subset)
        counts[tuple(sorted(subset.tolist()))] += 1
    mean = 10_000 / len(counts)
    assert np.abs(np.array(list(counts.values())) - mean).max() < 5 * np.sqrt(mean)


@laws
@given(seed=SEEDS, most=st.integers(0, 80))
def test_the_score_of_a_climb_is_that_of_its_pose(seed, most):
    R, t, m, n = pose_and_matches(seed, wrong=20)
    R, t = disturbed(R, t, seed, 1e-3)
    start = as_model(R, t)
    stages = np.array([[2 * THRESHOLD_RAD, THRESHOLD_RAD], [THRESHOLD_RAD, 0.5 * THRESHOLD_RAD]])
    model, *found = kernels.climb(m, n, start, THRESHOLD_RAD, stages, most, 6)
    R, t = kernels.rotation_of_model(model), model[4:]
    assert found == pytest.approx(score(m, n, R, t, THRESHOLD_RAD, np.inf), rel=1e-9)
    assert (np.abs(model - start).max() < 1e-14) == (most < 6)


@laws
@given(seed=SEEDS)
def test_refits_come_in_order_of_cost(seed):
    R, t, m, n = pose_and_matches(seed, wrong=20)
    uniform = np.random.default_rng(seed).random((20, 14))
    fits = kernels.refit(m, n, as_model(R, t), THRESHOLD_RAD, uniform, len(m), 6, 3)
    costs = costs_of(PoseProblem(m, n, THRESHOLD_RAD), fits).tolist()
    assert len(costs) == 3
    assert costs == sorted(costs)
    # The noise of 14 matches moves a fit by a few standard deviations.
    assert costs[0] < 2 * score(m, n, R, t, THRESHOLD_RAD, np.inf)[0]


def test_too_few_inliers_give_no_refit():
    R, t, m, n = pose_and_matches(0, 14, noise_rad=0.0)
    uniform = np.random.default_rng(0).random((20, 14))
    assert len(kernels.refit(m, n, as_model(R, t), THRESHOLD_RAD, uniform, 14, 6, 2)) == 0
