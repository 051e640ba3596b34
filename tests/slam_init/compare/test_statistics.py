"""Laws of the statistics, against textbook values and scipy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from slam_init.compare.statistics import cluster_mean, holm, mcnemar_exact, restricted_mean, wilson

counts = st.integers(0, 400)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(0, 10, 0.0, 0.27753), (5, 10, 0.23659, 0.76341), (10, 10, 0.72247, 1.0), (81, 263, 0.25525, 0.36621)],
)
def test_wilson_has_the_textbook_values(successes, trials, low, high):
    interval = wilson(successes, trials)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-4)


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


def test_more_successes_than_trials_are_refused():
    with pytest.raises(ValueError, match="successes"):
        wilson(3, 2)


def test_mcnemar_takes_no_and_thousands_of_trials():
    assert mcnemar_exact(0, 0) == 1.0
    assert mcnemar_exact(30_000, 31_000) == mcnemar_exact(31_000, 30_000) < 1e-4


@given(st.lists(st.floats(0, 1), max_size=12))
def test_holm_raises_p_values_and_keeps_their_order(p_values):
    adjusted = holm(p_values)
    assert all(a >= p for a, p in zip(adjusted, p_values, strict=True))
    order = np.argsort(p_values, kind="stable")
    assert (np.diff(np.array(adjusted)[order]) >= 0).all()


def test_holm_has_the_textbook_values():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_a_trial_that_fails_counts_as_its_limit():
    assert restricted_mean([10, math.nan, 30], [50, 50, 20]).value == pytest.approx((10 + 50 + 20) / 3)


@given(st.lists(st.tuples(st.floats(0, 100), st.floats(1, 100)), min_size=2, max_size=30))
def test_the_restricted_mean_is_at_most_the_mean_limit_and_grows_with_it(trials):
    times, limits = np.array(trials).T
    mean = restricted_mean(times, limits)
    assert mean.low <= mean.value <= mean.high
    assert mean.value <= limits.mean() + 1e-9
    assert restricted_mean(times, limits + 1).value >= mean.value - 1e-9


def test_the_bootstrap_over_clusters_of_one_value_has_the_normal_interval_of_a_mean():
    rng = np.random.default_rng(1)
    values = rng.normal(3.0, 2.0, 400)
    interval = cluster_mean(values, np.arange(400).astype(object))
    half = 1.96 * values.std() / math.sqrt(400)
    assert interval.value == pytest.approx(values.mean())
    assert (interval.low, interval.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.15 * half)


def test_values_of_one_cluster_do_not_count_as_independent():
    rng = np.random.default_rng(2)
    means = rng.normal(0.0, 1.0, 30)
    clusters = np.repeat(np.arange(30), 50).astype(object)
    wide = cluster_mean(np.repeat(means, 50), clusters)
    once = cluster_mean(means, np.arange(30).astype(object))
    assert (wide.low, wide.high) == pytest.approx((once.low, once.high))


def test_the_bootstrap_repeats_itself_and_covers_the_mean_in_95_percent_of_the_cases():
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(200):
        values = np.repeat(rng.normal(0.0, 1.0, 25), 4) + rng.normal(0.0, 0.3, 100)
        clusters = np.repeat(np.arange(25), 4).astype(object)
        interval = cluster_mean(values, clusters)
        assert interval == cluster_mean(values, clusters)
        covered += interval.low <= 0 <= interval.high
    assert 0.88 <= covered / 200 <= 0.98


def test_the_mean_of_no_values_is_not_known():
    assert math.isnan(cluster_mean(np.zeros(0), np.zeros(0, object)).value)
