"""Compiled local optimization: subsets, refinement in stages, refits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import THRESHOLD_RAD, as_model, disturbed, pose_and_matches, score

from quest.robust import kernels

SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=40)


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
