"""The compiled search over samples: the pool of modes, its order, and its independence of the order of the data."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_pose_matches import THRESHOLD_RAD, pose_and_matches, score

from quest.robust import kernels
from quest.robust.kernels.samples import SAME_MODE_RAD, mode_distance
from quest.robust.samples import draw_samples

SEEDS = st.integers(0, 2**32 - 1)


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
