"""Times by stage."""

import pytest

from slam_init.types.stopwatch import Stopwatch


def test_a_summary_holds_the_quantiles_the_largest_the_sum_and_the_number_of_calls():
    now = [0.0]
    stopwatch = Stopwatch(lambda: now[0])
    for time_ms in (0.5, 1.5, 3.0, 4.0, 2000.0):
        with stopwatch("stage"):
            now[0] += 1e-3 * time_ms
        assert stopwatch.last_ms("stage") == pytest.approx(time_ms)
    expected = {"median": 3.0, "p95": 1600.8, "p99": 1920.16, "largest": 2000.0, "total": 2009.0, "calls": 5}
    assert stopwatch.summary() == {"stage": pytest.approx(expected)}
