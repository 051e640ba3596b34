"""The report for the terminal: the verdict first, then the figures that there are."""

from dataclasses import fields, replace
from pathlib import Path

from make_map import make_map, make_result
from make_summary import summarize

from slam_init.output.records import ContinuationRecord, ScaleRecord
from slam_init.output.report import report_text
from slam_init.types.evidence import Margin, WindowEvidence
from slam_init.types.reasons import Verdict
from slam_init.types.result import GroundTruthErrors
from slam_init.types.scale import ScaleOrigin


def lines_of(summary):
    """The title, and the texts by name."""
    title, *lines = report_text(summary, Path("out")).splitlines()
    return title, {line[2:16].strip(): line[16:] for line in lines}


def test_a_map_is_reported_with_its_quality():
    truth = GroundTruthErrors(rotation_error_deg=0.25, direction_error_deg=None, ate_rmse=0.01, path_length=1.5)
    summary = summarize(make_result(make_map()), ground_truth=truth, continued=ContinuationRecord(10, 9, 0.8, 0.7))
    title, lines = lines_of(summary)
    assert title == "initialized after 22 frames"
    assert lines["keyframes"] == "4 (frames 10, 17, 24, 31)"
    assert lines["landmarks"] == "60, general scene"
    assert lines["parallax"] == "12.50 deg (median)"
    assert lines["ground truth"] == "rotation 0.25 deg, ATE 0.01"
    assert lines["continued"] == "9 of 10 further frames located, 80% of the landmarks seen (median)"
    assert lines["attempts"] == "3 (2 low parallax, 1 accepted)"
    assert lines["results"] == "out/ (look at it: slam-init view out)"


def test_the_risk_of_the_last_window_is_reported_with_the_depths_of_the_landmarks():
    """A window has tracks at infinity and outliers, which are no landmarks: their depths are not those of the map."""
    summary = summarize(make_result(make_map()))
    zeros = WindowEvidence(**{field.name: 0 for field in fields(WindowEvidence)})
    window = replace(zeros, risk=0.00321, direction_sigma_deg=3.14, depth_sigma=29321.0)
    summary = replace(summary, attempts=(*summary.attempts[:-1], replace(summary.attempts[-1], window=window)))
    assert lines_of(summary)[1]["risk"] == "0.0032 that the map is wrong, direction +- 3.1 deg, depths +- 2.0%"


def test_a_refusal_is_reported_with_its_advice():
    title, lines = lines_of(summarize(make_result(None, Verdict.STATIC_CAMERA)))
    assert title == "not initialized: static camera"
    assert lines["advice"] == Verdict.STATIC_CAMERA.advice
    assert lines["frames read"] == "32"
    assert "keyframes" not in lines


def test_two_undecided_maps_are_reported_with_their_margin():
    result = replace(
        make_result(None, Verdict.AMBIGUOUS_PLANE), hypotheses=(make_map(), make_map()), margin=Margin(3.0, 1.5)
    )
    _, lines = lines_of(summarize(result))
    assert lines["kept"] == "two maps of frames 10, 17, 24, 31; the tracks prefer the first by 3.0 nats"


def test_a_scale_does_not_hide_that_depths_are_less_certain():
    origin = ScaleRecord(ScaleOrigin.DISTANCE, "frames 0 and 4", "")
    summary = summarize(make_result(make_map()))
    summary = replace(summary, depth_sigma=0.11, scale=2.0, scale_sigma=0.001, scale_origin=origin)
    assert "+- 0.1% (distance: frames 0 and 4); the depth of a landmark to +- 11%;" in lines_of(summary)[1]["scale"]
    certain = replace(summary, scale_sigma=0.2)
    assert "depth of a landmark" not in lines_of(certain)[1]["scale"]
