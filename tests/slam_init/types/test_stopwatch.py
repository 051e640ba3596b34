"""Times by stage: all calls are counted, and a bounded number of times is kept."""

import numpy as np
import pytest

from slam_init.types.stopwatch import Stopwatch


def timed(times_ms, **options):
    """A stopwatch that has measured these times."""
    now = [0.0]
    stopwatch = Stopwatch(lambda: now[0], **options)
    for time_ms in times_ms:
        with stopwatch("stage"):
            now[0] += 1e-3 * time_ms
        assert stopwatch.last_ms("stage") == pytest.approx(time_ms)
    return stopwatch


def test_a_summary_holds_the_quantiles_the_sum_and_the_histogram():
    summary = timed([0.5, 1.5, 3.0, 4.0, 2000.0]).summary()["stage"]
    assert (summary["median"], summary["largest"], summary["total"], summary["calls"]) == (3.0, 2000.0, 2009.0, 5)
    assert summary["histogram"] == [1, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 1]


def test_dropped_times_are_counted_and_the_quantiles_are_those_of_the_last_calls():
    times_ms = np.random.default_rng(0).uniform(0.1, 1500.0, 1000)
    few, all_ = (timed(times_ms, **options).summary()["stage"] for options in ({"kept": 50}, {}))
    for name in ("largest", "total", "calls", "histogram"):
        assert few[name] == pytest.approx(all_[name], abs=2e-3)
    last = timed(times_ms[-50:]).summary()["stage"]
    assert few["median"] == last["median"]
    assert few["p99"] == last["p99"]


@pytest.mark.parametrize("calls", [99, 100, 5000])
def test_the_number_of_kept_times_is_bounded(calls):
    stopwatch = timed([1.0] * calls, kept=50)
    assert len(stopwatch._stages["stage"].samples_ms) <= 100
