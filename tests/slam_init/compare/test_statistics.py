"""Laws of the statistics, against textbook values and scipy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from slam_init.compare.statistics import cluster_mean, holm, restricted_mean, wilson

counts = st.integers(0, 400)


@settings(max_examples=15, deadline=None)
@given(counts, counts)
def test_wilson_is_scipys_and_symmetric(successes, failures):
    trials = successes + failures
    if trials == 0:
        assert math.isnan(wilson(0, 0).low)
        return
    ours, theirs = wilson(successes, trials), stats.binomtest(successes, trials).proportion_ci(0.95, "wilson")
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    mirrored = wilson(failures, trials)
    assert (1 - ours.high, 1 - ours.low) == pytest.approx((mirrored.low, mirrored.high), abs=1e-12)
    assert 0 <= ours.low <= ours.value <= ours.high <= 1


def test_holm_has_the_textbook_values():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 100), st.floats(1, 100)), min_size=2, max_size=30))
def test_the_restricted_mean_is_at_most_the_mean_limit_and_grows_with_it(trials):
    times, limits = np.array(trials).T
    mean = restricted_mean(times, limits)
    assert mean.low <= mean.value <= mean.high
    assert mean.value <= limits.mean() + 1e-9
    assert restricted_mean(times, limits + 1).value >= mean.value - 1e-9


def test_values_of_one_cluster_do_not_count_as_independent():
    rng = np.random.default_rng(2)
    means = rng.normal(0.0, 1.0, 30)
    clusters = np.repeat(np.arange(30), 50).astype(object)
    wide = cluster_mean(np.repeat(means, 50), clusters)
    once = cluster_mean(means, np.arange(30).astype(object))
    assert (wide.low, wide.high) == pytest.approx((once.low, once.high))
