"""The likelihood of a residual: its weights, its limits, and that of a motion as the sum over its matches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make_pose_matches import THRESHOLD_RAD, as_model, matches_of_all_kinds

from quest.noise import log_likelihood, log_likelihoods_of
from quest.robust.loss import OUTLIERS, REACH, SCALE, log_likelihoods, weights
from quest.robust.pose_problem import PoseProblem

SCALES = st.sampled_from([1e-6, 1.0, 1e3])


@given(ratio=st.floats(1e-3, 100), scale=SCALES)
def test_the_weight_is_the_derivative_of_the_likelihood_over_the_residual_and_one_at_zero(ratio, scale):
    r = ratio * scale
    step = 1e-4 * r
    slope = np.subtract(*log_likelihoods(r + np.array([step, -step]), scale)) / (2 * step)
    curvature_at_zero = 2 / (scale**2 * (1 + OUTLIERS))
    assert weights(np.array([0.0]), scale) == pytest.approx([1.0])
    assert -slope == pytest.approx(curvature_at_zero * weights(np.array([r]), scale)[0] * r, rel=1e-5)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_likelihood_of_a_motion_is_the_sum_over_its_matches_and_zero_beyond_reach_and_behind_a_camera(seed):
    R, t, m, n = matches_of_all_kinds(seed)
    problem, model = PoseProblem(m, n, THRESHOLD_RAD), as_model(R, t)
    r2 = problem.residuals(model)
    counts = np.sqrt(r2) < REACH * THRESHOLD_RAD
    each = log_likelihoods_of(problem, model)
    assert not each[~counts].any()
    assert each[counts] == pytest.approx(log_likelihoods(np.sqrt(r2[counts]), SCALE * THRESHOLD_RAD))
    assert log_likelihood(problem, model) == pytest.approx(each.sum())
