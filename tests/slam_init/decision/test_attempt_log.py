"""Laws of the log of attempts: what it keeps, the reason of a run, and the notes for the user."""

import numpy as np

from slam_init.decision.attempt_log import AttemptLog
from slam_init.types.evidence import FreeFocal
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt, stated_reason
from slam_init.types.status import Status


def refusal(k, verdict=Verdict.LOW_PARALLAX, reference=0, progress=0.0, **fields):
    """An attempt on the pair of a reference and frame k, with nine matches."""
    return Attempt(
        (reference, k),
        verdict,
        f"advice {k}",
        progress=progress,
        pixels1=np.ones((9, 2)),
        pixels2=np.ones((9, 2)),
        inliers=np.ones(9, bool),
        **fields,
    )


def test_of_many_attempts_the_last_are_kept_without_their_matches_and_all_are_counted_and_vote_on_the_reason():
    """Of the second half, 25 were static and 25 had low parallax; the first in the list of reasons is reported."""
    log = AttemptLog(limit=10)
    assert log.prevailing_reason() == Verdict.TOO_FEW_FRAMES
    for k in range(100):
        log.add(refusal(k, Verdict.STATIC_CAMERA if k < 75 else Verdict.LOW_PARALLAX))
    assert len(log) == 100
    assert [attempt.frames[1] for attempt in log.kept] == list(range(90, 100))
    assert all(len(attempt.pixels1) == len(attempt.inliers) == 0 for attempt in log.kept)
    assert log.notes() == ("100 attempts were made; the last 10 are listed",)
    assert log.advice(Verdict.LOW_PARALLAX) == "advice 99"
    assert log.advice(Verdict.STATIC_CAMERA) == Verdict.STATIC_CAMERA.advice  # no kept attempt was static
    assert log.prevailing_reason() == Verdict.STATIC_CAMERA
    log.add(refusal(100))
    assert log.prevailing_reason() == Verdict.LOW_PARALLAX


# -- notes on the focal length --------------------------------------------------------------------


def test_the_newest_free_fit_decides_whether_the_stated_focal_length_is_wrong():
    cases = (
        ((), None),
        (((600.0, 20.0, False),), None),
        (((1200.0, 90.0, False), (600.0, 20.0, True)), 600.0),
        (((600.0, 20.0, True), (1200.0, 90.0, False)), None),
        (((600.0, 20.0, True), (610.0, 10.0, True), (580.0, 30.0, True)), 580.0),
    )
    for fits, estimated_px in cases:
        log = AttemptLog(limit=1)
        for k, (found_px, sigma_px, contradicts) in enumerate(fits):
            log.add(refusal(k, free_focal=FreeFocal(1230.0, found_px, sigma_px, contradicts)))
        wrong, last = log.wrong_focal, log.add(refusal(99))
        assert last.advice == (wrong.note if wrong is not None else "advice 99")
        assert (None if wrong is None else wrong.estimated_px) == estimated_px
        message = () if wrong is None else (wrong.note,)
        assert log.notes()[: len(message)] == message
        assert log.advice(Verdict.LOW_PARALLAX) == last.advice
        message = Verdict.WRONG_FOCAL_LENGTH if wrong is not None else last.verdict
        assert log.prevailing_reason() == Status().after(last, 0.0, wrong).reason == message
        assert stated_reason(Verdict.UNKNOWN_FOCAL_LENGTH, wrong) == "unknown_focal_length"
