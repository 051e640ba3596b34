"""The texts of a recording: each verdict with its evidence, and the result."""

from dataclasses import replace

from make_map import make_attempts, make_map, make_preview, make_result
from make_summary import summarize

from slam_init.recording.text import advice_markdown, attempt_markdown, evidence_markdown
from slam_init.types.evidence import FreeFocal, MapEvidence
from slam_init.types.refusal import Verdict


def test_the_text_of_an_attempt_has_all_evidence_that_is_known():
    attempt = replace(
        make_attempts(make_map())[0],
        preview=make_preview(parallax_px=3.5),
        free_focal=FreeFocal(500.0, 505.0, 9.0, contradicts=False),
        map=MapEvidence(failure="too few points"),
        method_evidence={"parallax_min_deg": 1.0},
    )
    text = evidence_markdown(attempt)
    rows = ("parallax_px | 3.5", "free_focal_estimated_px | 505", "risk_direction | 0.07", "parallax_min_deg | 1")
    for row in (*rows, "failure | too few points"):
        assert f"| {row} |" in text
    assert "reprojection_rmse_px" not in text
    assert "--camera" not in attempt_markdown(attempt)  # nothing is wrong
    wrong = FreeFocal(1000.0, 505.0, 9.0, contradicts=True)
    for result in (make_result(make_map()), make_result(None, Verdict.LOW_PARALLAX)):
        summary = summarize(replace(result, wrong_focal=wrong, advice=wrong.note, notes=(wrong.note,)))
        assert "check --camera" in advice_markdown(summary)
