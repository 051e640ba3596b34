"""Laws of the margin of a vote."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam_init.types.evidence import Margin

Z, LOG_LIKELIHOOD = Margin(0.0, 0.0).z_needed, Margin.LOG_LIKELIHOOD_NEEDED
margins = st.builds(Margin, st.floats(-1e6, 1e6), st.floats(-1e3, 1e3))


def test_a_margin_decides_if_both_figures_reach_their_required_values():
    assert Margin(LOG_LIKELIHOOD, Z).decides()
    assert not Margin(0.99 * LOG_LIKELIHOOD, 10 * Z).decides()
    assert not Margin(10 * LOG_LIKELIHOOD, 0.99 * Z).decides()
    assert Margin(LOG_LIKELIHOOD, 3.0, z_needed=3.0).decides()


def test_the_decision_ratio_is_that_of_the_weaker_figure():
    assert Margin(0.5 * LOG_LIKELIHOOD, 0.8 * Z).decision_ratio() == pytest.approx(0.5)
    assert Margin(2.0 * LOG_LIKELIHOOD, 0.8 * Z).decision_ratio() == pytest.approx(0.8)


@given(margins)
def test_a_margin_and_its_reverse_never_both_decide(margin):
    assert not (margin.decides() and Margin(-margin.log_likelihood, -margin.z).decides())
    assert margin.decides() == (margin.decision_ratio() >= 1)
