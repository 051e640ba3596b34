"""Words and colours of the pictures."""

import pytest

from slam_init.pictures.overview import VERDICT_COLORS, gate_words, wrapped
from slam_init.types.gates import GateName, at_least, at_most
from slam_init.types.reasons import Verdict


def test_every_verdict_has_a_colour_of_its_own():
    assert set(VERDICT_COLORS) == set(Verdict)
    assert len({VERDICT_COLORS[verdict] for verdict in Verdict}) == len(Verdict)


@pytest.mark.parametrize(
    ("gate", "words"),
    [
        (at_most(GateName.RISK, 0.03, 0.005, Verdict.LOW_PARALLAX), "risk 0.03, needs at most 0.005"),
        (at_least(GateName.MOTION_PX, 1.5, 2.12, Verdict.STATIC_CAMERA), "motion 1.5 px, needs at least 2.12 px"),
    ],
)
def test_a_gate_in_words_has_value_side_bound_and_unit(gate, words):
    assert gate_words(gate) == words


def test_a_long_text_is_cut_and_says_so():
    assert wrapped("one two three four", 9, 1) == "one ..."
    assert wrapped("a\nb", 9) == r"a\nb"
