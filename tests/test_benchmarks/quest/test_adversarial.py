"""A sample of the adversarial inputs; all of them: ``python -m tests.benchmarks.quest.adversarial``."""

import numpy as np
import pytest

from tests.benchmarks.quest.adversarial import FUNCTIONS, defect_of, judge


@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_input_breaks_a_function(name):
    found = [judge(name, seed=1, index=index) for index in range(50)]
    assert [what for outcome, what in found if outcome == "broken"] == []
    assert {outcome for outcome, _ in found} == {"answer", "InputError"}


def test_a_wrong_answer_is_detected():
    assert defect_of(np.full((1, 4), np.nan)) == "an invalid quaternion"
    assert defect_of((2 * np.ones(3), np.ones(5), np.ones(5))) == "an invalid translation"
