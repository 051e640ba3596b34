"""Laws of time stamps: the unit is recognized by size and step, and what is no time is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam_init.types.time_stamps import LARGEST_STAMP, TimeUnit, in_seconds, problem_of, time_unit

BEGINNINGS_S = {"from zero": 0.0, "up for five days": 432_000.5, "a date": 1_403_636_579.763}


@pytest.mark.parametrize("unit", TimeUnit)
@pytest.mark.parametrize("begin_s", BEGINNINGS_S.values(), ids=BEGINNINGS_S)
@given(rate_hz=st.floats(1, 400), count=st.integers(2, 30))
def test_the_unit_of_a_video_is_recognized_whatever_it_is_and_wherever_it_starts(unit, begin_s, rate_hz, count):
    times_s = begin_s + np.arange(count) / rate_hz
    stamps = times_s * unit.per_second
    # Seconds stay seconds up to a step of 10 s, so that milliseconds at more than 100 Hz need a date to be
    # distinguished.
    if unit == TimeUnit.MILLISECONDS and begin_s < 1e9 and rate_hz >= 100:
        assert time_unit(stamps) in (TimeUnit.MILLISECONDS, TimeUnit.SECONDS)
        return
    found = time_unit(stamps)
    assert found == unit
    np.testing.assert_allclose(in_seconds(stamps, found), times_s, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("unit", TimeUnit)
def test_a_single_date_determines_its_unit_by_its_size(unit):
    assert time_unit(np.array([1_403_636_579.763 * unit.per_second])) == unit


@pytest.mark.parametrize("step_s", [0.5, 5.0, 10.0])
def test_photographs_some_seconds_apart_keep_their_seconds(step_s):
    assert time_unit(np.arange(5) * step_s) == TimeUnit.SECONDS
    assert time_unit(1_403_636_579 + np.arange(5) * 60 * step_s) == TimeUnit.SECONDS


def test_one_long_gap_does_not_change_the_unit():
    stamps = np.concatenate([np.arange(50) / 30, 500 + np.arange(50) / 30])
    assert time_unit(stamps) == TimeUnit.SECONDS


@pytest.mark.parametrize(
    ("stamp", "previous", "word"),
    [
        (float("nan"), None, "finite"),
        (float("inf"), 1.0, "finite"),
        (-1e-9, None, "negative"),
        (LARGEST_STAMP, None, "2\\^63"),
        (1.0, 1.0, "after"),
        (0.5, 1.0, "after"),
    ],
)
def test_each_stamp_that_is_no_time_has_a_problem(stamp, previous, word):
    assert word.replace("\\", "") in problem_of(stamp, previous)
