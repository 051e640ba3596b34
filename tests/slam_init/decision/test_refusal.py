"""Laws of refusals: the first gate that fails gives the reason and the advice."""

from slam_init.decision.refusal import refused_at, refused_by
from slam_init.types.gates import GateName, Stage, at_least, at_most, progress
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

ATTEMPT = Attempt((0, 1), Verdict.ACCEPTED)
PASSED = at_least(GateName.MATCHES, 60, 30, Verdict.TOO_FEW_MATCHES)
FAILED = at_most(GateName.RISK, 0.2, 0.1, Verdict.LOW_PARALLAX, "come nearer")
WORSE = at_least(GateName.LANDMARKS, 5, 50, Verdict.TOO_FEW_LANDMARKS)


def test_the_first_failed_gate_gives_reason_and_advice_and_the_worst_one_the_progress():
    attempt = refused_by(ATTEMPT, Stage.MAP, (PASSED, FAILED, WORSE))
    assert (attempt.verdict, attempt.advice, attempt.stage) == (Verdict.LOW_PARALLAX, "come nearer", Stage.MAP)
    assert attempt.progress == progress(Stage.MAP, (WORSE,)) < progress(Stage.MAP, (FAILED,))


def test_a_refusal_without_a_gate_has_the_advice_of_its_reason():
    attempt = refused_at(ATTEMPT, Verdict.PURE_ROTATION, Stage.MOTION)
    assert (attempt.verdict, attempt.stage) == (Verdict.PURE_ROTATION, Stage.MOTION)
    assert attempt.advice == Verdict.PURE_ROTATION.advice
    assert attempt.progress == progress(Stage.MOTION)


def test_a_refusal_of_another_system_has_no_stage_and_no_progress():
    attempt = refused_at(ATTEMPT, Verdict.LOW_PARALLAX)
    assert (attempt.verdict, attempt.stage, attempt.progress) == (Verdict.LOW_PARALLAX, None, 0.0)
