"""A sample of the inputs that mean harm; the whole is ``python -m quest.benchmarks.adversarial``."""

import numpy as np
import pytest

from quest.benchmarks.adversarial import FUNCTIONS, judge, promises_broken


@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_input_breaks_a_function(name):
    found = [judge(name, seed=1, index=index) for index in range(80)]
    assert [what for outcome, what in found if outcome == "broken"] == []
    assert {outcome for outcome, _ in found} == {"answer", "InputError"}


def test_a_broken_promise_is_seen():
    assert promises_broken(np.full((1, 4), np.nan)) == "a quaternion that is none"
    assert promises_broken((2 * np.ones(3), np.ones(5), np.ones(5))) == "a translation that is none"
