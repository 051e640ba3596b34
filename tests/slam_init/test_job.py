"""The line that a terminal shows while a run waits."""

from dataclasses import replace

import pytest
from make_map import make_attempts, make_map, make_window_evidence

from slam_init.job import live_text
from slam_init.types.reasons import Verdict
from slam_init.types.status import State, Status


@pytest.mark.parametrize("reason", [Verdict.STATIC_CAMERA, Verdict.PURE_ROTATION, Verdict.AMBIGUOUS_PLANE])
def test_the_line_tells_the_reason_and_the_risk_of_the_frame(reason):
    waiting = Status(State.WAITING, 0.2, reason, "move")
    assert live_text(waiting) == str(reason).replace("_", " ")
    attempt = make_attempts(make_map())[-1]
    window = make_window_evidence(0.0312)
    judged = replace(waiting, attempt=replace(attempt, window=window), window=window)
    assert live_text(judged) == f"{str(reason).replace('_', ' ')}, risk 0.031"


def test_a_map_ends_the_wait():
    assert live_text(Status.initialized(None)) == "initialized"
