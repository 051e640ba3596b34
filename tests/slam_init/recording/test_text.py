"""The texts of a recording: each verdict with its evidence, and the summary."""

from dataclasses import replace

from make_map import make_attempts, make_map, make_preview, make_result
from make_summary import summarize

from slam_init.recording.text import (
    advice_markdown,
    attempt_markdown,
    evidence_markdown,
    summary_markdown,
)
from slam_init.types.evidence import FreeFocal, MapEvidence
from slam_init.types.reasons import Verdict


def test_the_text_of_an_attempt_has_verdict_advice_and_gates():
    refused, *_, accepted = (attempt_markdown(attempt) for attempt in make_attempts(make_map()))
    assert "refused: low parallax" in refused
    assert Verdict.LOW_PARALLAX.advice in refused
    assert "| matches | 60 | ≥ 30 |  |" in refused
    assert "| risk | 0.07 | ≤ 0.005 | **fails** |" in refused
    assert "**accepted**" in accepted
    assert "fails" not in accepted


def test_the_verdict_names_the_largest_part_of_the_risk_and_fits_a_small_panel():
    refused = make_attempts(make_map())[0]
    rival = replace(refused, window=replace(refused.window, risk_direction=0.01, risk_rival=0.06))
    text = attempt_markdown(rival)
    assert "largest part of the risk: another motion, 0.06" in text
    assert "#" not in text
    assert len(text.splitlines()) <= 10


def test_the_text_of_an_attempt_has_all_evidence_that_is_known():
    attempt = replace(
        make_attempts(make_map())[0],
        preview=make_preview(parallax_px=3.5),
        free_focal=FreeFocal(500.0, 505.0, 9.0, contradicts=False),
        map=MapEvidence(failure="too few points"),
        method_evidence={"parallax_min_deg": 1.0},
    )
    text = evidence_markdown(attempt)
    for row in (
        "| parallax_px | 3.5 |",
        "| free_focal_estimated_px | 505 |",
        "| risk_direction | 0.07 |",
        "| direction_sigma_deg | 4 |",
        "| failure | too few points |",
        "| parallax_min_deg | 1 |",
    ):
        assert row in text
    assert "--camera" not in attempt_markdown(attempt)  # nothing is wrong
    wrong = FreeFocal(1000.0, 505.0, 9.0, contradicts=True)
    assert wrong.note in attempt_markdown(replace(attempt, free_focal=wrong))
    for result in (make_result(make_map()), make_result(None, Verdict.LOW_PARALLAX)):
        summary = summarize(replace(result, wrong_focal=wrong, advice=wrong.note, notes=(wrong.note,)))
        assert "check --camera" in advice_markdown(summary)
        assert wrong.note in summary_markdown(summary)
    assert "reprojection_rmse_px" not in text


def test_a_hostile_name_is_escaped():
    summary = summarize(make_result(make_map()))
    hostile = replace(summary, source=replace(summary.source, name="a\n# forged\u202e\udcff"), notes=("b\nc",))
    text = summary_markdown(hostile)
    assert r"a\n# forged\u202e\udcff" in text and r"- b\nc" in text
    text.encode()


def test_a_pipe_in_a_text_does_not_break_the_table():
    attempt = replace(make_attempts(make_map())[0], method_evidence={"rule": "a|b"})
    assert "| rule | a/b |" in evidence_markdown(attempt)
