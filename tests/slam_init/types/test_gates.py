"""Laws of gates: which values pass, how near a value is to its threshold, and the progress of a pair."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slam_init.types.gates import Direction, Gate, GateName, Stage, at_least, at_most, progress
from slam_init.types.reasons import Verdict

#: A figure that has to be small, and one that has to be large.
RISK, COUNT = GateName.RISK, GateName.LANDMARKS
numbers = st.floats(-1e6, 1e6, allow_nan=False)


def small(value: float, threshold: float) -> Gate:
    return at_most(RISK, value, threshold, Verdict.LOW_PARALLAX)


def large(value: float, threshold: float) -> Gate:
    return at_least(COUNT, value, threshold, Verdict.TOO_FEW_LANDMARKS)


def test_a_value_at_the_threshold_passes_and_nan_never_passes():
    assert large(1.0, 1.0).passes()
    assert small(1.0, 1.0).passes()
    assert not large(np.nextafter(1.0, 0.0), 1.0).passes()
    assert not small(np.nextafter(1.0, 2.0), 1.0).passes()
    assert not large(float("nan"), 0.0).passes()
    assert not small(float("nan"), 0.0).passes()


def test_a_gate_takes_its_unit_from_its_name_and_its_advice_from_its_reason():
    gate = at_most(GateName.MOTION_PX, 7.0, 5.0, Verdict.LOW_PARALLAX)
    assert (gate.unit, gate.direction, gate.reason) == ("px", Direction.AT_MOST, Verdict.LOW_PARALLAX)
    assert gate.advice == Verdict.LOW_PARALLAX.advice
    other = at_most(GateName.MOTION_PX, 7.0, 5.0, Verdict.LOW_PARALLAX, "come nearer")
    assert other == replace(gate, advice="come nearer")
    assert large(1.0, 1.0).unit == ""
    assert large(1.0, 1.0).direction is Direction.AT_LEAST


@given(numbers, st.floats(1e-3, 1e6), st.sampled_from([small, large]))
def test_the_gate_fraction_is_one_exactly_if_the_gate_passes(value, threshold, make):
    gate = make(value, threshold)
    assert 0 <= gate.gate_fraction() <= 1
    assert (gate.gate_fraction() == 1) == gate.passes()


def test_the_gate_fraction_is_the_ratio_of_value_and_threshold():
    assert large(1.0, 2.0).gate_fraction() == 0.5
    assert small(4.0, 2.0).gate_fraction() == 0.5
    for not_finite in (float("nan"), float("inf")):
        assert small(not_finite, 2.0).gate_fraction() == 0
    assert large(float("nan"), 2.0).gate_fraction() == 0


def test_the_progress_grows_with_the_stage_and_with_the_gate_farthest_from_its_threshold():
    half, passed = large(1.0, 2.0), large(3.0, 2.0)
    assert progress(Stage.MOTION, [half, passed]) == (1 + 0.5) / 4
    assert progress(Stage.MATCHES, [passed]) <= progress(Stage.MOTION) < progress(Stage.MOTION, [half])
    assert progress(Stage.MOTION, [half]) < progress(Stage.TWO_VIEWS)
    assert progress(Stage.MAP, [half]) < 1
    assert [progress(stage) for stage in Stage] == [0.0, 0.25, 0.5, 0.75]
