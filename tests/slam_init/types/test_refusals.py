"""Laws of verdicts, of the gates that give them, and of the margin of a vote."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam_init.types.evidence import Margin
from slam_init.types.refusal import GateName, Stage, Verdict, at_least, at_most, progress
from slam_init.types.result import Attempt

numbers = st.floats(-1e6, 1e6, allow_nan=False)


def small(value, threshold):
    """A gate of a figure that has to be small."""
    return at_most(GateName.RISK, value, threshold, Verdict.LOW_PARALLAX)


def large(value, threshold):
    """A gate of a figure that has to be large."""
    return at_least(GateName.LANDMARKS, value, threshold, Verdict.TOO_FEW_LANDMARKS)


def test_a_value_at_the_threshold_passes_and_nan_never_passes():
    assert large(1.0, 1.0).passes() and small(1.0, 1.0).passes()
    for gate in (large(np.nextafter(1, 0), 1.0), small(np.nextafter(1, 2), 1.0), large(np.nan, 0), small(np.nan, 0)):
        assert not gate.passes()


@given(numbers, st.floats(1e-3, 1e6), st.sampled_from([small, large]))
def test_the_gate_fraction_is_one_exactly_if_the_gate_passes(value, threshold, make):
    gate = make(value, threshold)
    assert 0 <= gate.gate_fraction() <= 1
    assert (gate.gate_fraction() == 1) == gate.passes()


def test_the_gate_fraction_is_the_ratio_of_value_and_threshold():
    gates = (large(1.0, 2.0), small(4.0, 2.0), small(np.nan, 2.0), small(np.inf, 2.0), large(np.nan, 2.0))
    assert [gate.gate_fraction() for gate in gates] == [0.5, 0.5, 0, 0, 0]


def test_the_progress_grows_with_the_stage_and_with_the_gate_farthest_from_its_threshold():
    half, passed = large(1.0, 2.0), large(3.0, 2.0)
    assert progress(Stage.MOTION, [half, passed]) == (1 + 0.5) / 4
    assert progress(Stage.MATCHES, [passed]) <= progress(Stage.MOTION) < progress(Stage.MOTION, [half])
    assert [progress(stage) for stage in Stage] == [0.0, 0.25, 0.5, 0.75]


Z, LOG_LIKELIHOOD = Margin(0.0, 0.0).z_needed, Margin.LOG_LIKELIHOOD_NEEDED


def test_a_margin_decides_by_its_weaker_figure():
    assert Margin(LOG_LIKELIHOOD, Z).decides() and Margin(LOG_LIKELIHOOD, 3.0, z_needed=3.0).decides()
    assert Margin(0.5 * LOG_LIKELIHOOD, 0.8 * Z).decision_ratio() == pytest.approx(0.5)
    assert Margin(2.0 * LOG_LIKELIHOOD, 0.8 * Z).decision_ratio() == pytest.approx(0.8)


@given(st.builds(Margin, numbers, st.floats(-1e3, 1e3)))
def test_a_margin_and_its_reverse_never_both_decide(margin):
    assert not (margin.decides() and Margin(-margin.log_likelihood, -margin.z).decides())
    assert margin.decides() == (margin.decision_ratio() >= 1)


ATTEMPT = Attempt((0, 1), Verdict.ACCEPTED)
PASSED = at_least(GateName.MATCHES, 60, 30, Verdict.TOO_FEW_MATCHES)
FAILED = at_most(GateName.RISK, 0.2, 0.1, Verdict.LOW_PARALLAX, "come nearer")
WORSE = at_least(GateName.LANDMARKS, 5, 50, Verdict.TOO_FEW_LANDMARKS)


def test_the_first_failed_gate_gives_reason_and_advice_and_the_worst_one_the_progress():
    attempt = ATTEMPT.refused_by(Stage.MAP, (PASSED, FAILED, WORSE))
    assert (attempt.verdict, attempt.advice, attempt.stage) == (Verdict.LOW_PARALLAX, "come nearer", Stage.MAP)
    assert attempt.progress == progress(Stage.MAP, (WORSE,)) < progress(Stage.MAP, (FAILED,))


def test_a_refusal_without_a_gate_has_the_advice_of_its_reason():
    attempt = ATTEMPT.refused_at(Verdict.PURE_ROTATION, Stage.MOTION)
    assert (attempt.verdict, attempt.stage) == (Verdict.PURE_ROTATION, Stage.MOTION)
    assert attempt.advice == Verdict.PURE_ROTATION.advice
    assert attempt.progress == progress(Stage.MOTION)


def test_a_refusal_of_another_system_has_no_stage_and_no_progress():
    attempt = ATTEMPT.refused_at(Verdict.LOW_PARALLAX)
    assert (attempt.verdict, attempt.stage, attempt.progress) == (Verdict.LOW_PARALLAX, None, 0.0)
