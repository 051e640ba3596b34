"""The benchmark of the first call: the break-even number of calls, and the table."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.benchmarks.quest.first_call import break_even, table


@given(first=st.floats(1, 1e5), later=st.floats(1, 100), other=st.floats(1, 1000))
def test_the_break_even_is_the_first_number_of_calls_that_saves_time(first, later, other):
    # Times closer than the resolution of a clock break even after so many calls that rounding decides.
    assume(later >= other or other - later > 1e-6)
    calls = break_even(first, later, other)

    def pays(k: float) -> bool:
        return first + (k - 1) * later <= k * other

    if calls == np.inf:
        assert later >= other
        assert not pays(1)
    else:
        assert first + (calls - 1) * later <= calls * other * (1 + 1e-12)
        assert calls == 1 or not pays(calls - 1)


def test_the_table_of_first_calls_has_medians_with_and_without_machine_code_on_disk():
    cold = [{"numpy": 1.0, "quest": 2.0, "first": first, "later": 10.0, "quest7": 60.0} for first in (1e9, 1010.0, 0.0)]
    rows = table(cold, [run | {"first": 60.0} for run in cold]).splitlines()
    assert [cell.strip() for cell in rows[2].strip("| ").split("|")][1:] == [
        "1.0",
        "2.0",
        "1010.0",
        "10.0",
        "60.0",
        "20",
    ]
    assert rows[3].split("|")[-2].strip() == "1"
