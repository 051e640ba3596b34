"""The report for the terminal: the verdict first, then the figures that there are."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from make_map import make_map, make_result, make_window_evidence
from make_summary import summarize, write_results

from slam_init.errors import SourceError
from slam_init.output.report import earlier_result, is_result_folder, read_result, report_text, result_text
from slam_init.output.summary import ContinuationRecord
from slam_init.types.evidence import Margin
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt, GroundTruthErrors
from slam_init.types.scale import Scale, ScaleOrigin


def lines_of(result, **further):
    """The title, and the texts by name. The text of the result alone has the same lines, but for what the run knows."""
    printed = report_text(result, summarize(result, **further), Path("out")).splitlines()
    title, *lines = (re.sub(r"^(  \S+( \S+)*) +", r"\1  ", line) for line in printed)
    alone = [re.sub(r"^(  \S+( \S+)*) +", r"\1  ", line) for line in str(result).splitlines()]
    assert [line for line in (title, *lines) if line in alone] == alone
    assert len(lines) - (len(alone) - 1) == 1 + len(further)
    return title, dict(line.strip().split("  ", 1) for line in lines)


def test_a_map_is_reported_with_its_quality():
    truth = GroundTruthErrors(rotation_error_deg=0.25, direction_error_deg=None, ate_rmse=0.01, path_length=1.5)
    continued = ContinuationRecord(10, 9, 0.8, 0.7)
    title, lines = lines_of(make_result(make_map()), ground_truth=truth, continued=continued)
    assert title == "initialized after 22 frames"
    assert lines["keyframes"] == "4 (frames 10, 17, 24, 31)"
    assert lines["landmarks"] == "60, general scene"
    assert lines["parallax"] == "12.50 deg (median)"
    assert lines["ground truth"] == "rotation 0.25 deg, ATE 0.667% of the path"
    assert lines["continued"] == "9 of 10 further frames located, 80% of the landmarks seen (median)"
    assert lines["attempts"] == "3 (2 low parallax, 1 accepted)"
    assert lines["results"] == "out/ (look at overview.png, or: slam-init view out)"


def test_the_risk_of_the_last_window_is_reported_with_the_depths_of_the_landmarks():
    """A window has tracks at infinity and outliers, which are no landmarks: their depths are not those of the map."""
    result = make_result(make_map())
    window = replace(make_window_evidence(0.00321), direction_sigma_deg=3.14, depth_sigma=29321.0)
    result = replace(result, attempts=(*result.attempts[:-1], replace(result.attempts[-1], window=window)))
    told = "0.012 that the map is wrong (0.0032 by the model, 0.009 by what it lacks)"
    assert lines_of(result)[1]["risk"] == f"{told}, direction +- 3.1 deg, depths +- 2.0%"


def test_two_undecided_maps_are_reported_with_their_margin():
    for ahead, preferred in ((3.0, "the first"), (-3.0, "the second")):
        result = replace(
            make_result(None, Verdict.AMBIGUOUS_PLANE), hypotheses=(make_map(), make_map()), margin=Margin(ahead, 1.5)
        )
        _, lines = lines_of(result)
        assert lines["kept"] == f"two maps of frames 10, 17, 24, 31; the tracks prefer {preferred} by 3.0 nats"


def test_a_scale_does_not_hide_that_depths_are_less_certain():
    map_ = replace(make_map(), depth_sigmas=np.full(len(make_map().points), 0.11))
    scale = Scale(ScaleOrigin.DISTANCE, 2.0, 0.001, "frames 0 and 4")
    result = replace(make_result(map_), scale=scale)
    assert "+- 0.1% (distance: frames 0 and 4); the depth of a landmark to +- 11%;" in lines_of(result)[1]["scale"]
    assert "depth of a landmark" not in lines_of(replace(result, scale=replace(scale, sigma=0.2)))[1]["scale"]


def test_what_a_person_has_to_know_is_reported():
    """The focal length, all notes and all verdicts."""
    map_ = replace(make_map(), focal_factor=1.1, focal_factor_sigma=0.02)
    estimated = replace(map_, camera=replace(map_.camera, source="estimated", focal_sigma=0.02))
    verdicts = [verdict for verdict in Verdict if verdict != Verdict.ACCEPTED][:6]
    result = replace(make_result(map_), notes=("one\nnote",), attempts=tuple(Attempt((0, 1), one) for one in verdicts))
    _, lines = lines_of(result)
    assert lines["focal length"] == "1.100 +- 0.020 times the stated one (adjusted)"
    assert lines["note"] == "one\\nnote"
    assert lines["attempts"].count("1 ") == len(verdicts)
    _, lines = lines_of(replace(result, map=estimated))
    told = f"{map_.camera.fx:.0f} +- {0.02 * map_.camera.focal_px:.0f} px, estimated from the motion"
    assert lines["focal length"] == told


# -- the report of a folder ------------------------------------------------------------------------


def written(folder, result):
    write_results(folder, result, summarize(result), "seed = 0\n")
    return folder


def test_a_refusal_is_reported_with_its_advice(tmp_path):
    facts = read_result(written(tmp_path / "out", make_result(None, Verdict.PURE_ROTATION)))
    assert (facts["reason"], facts["keyframes"]) == ("pure_rotation", [])
    assert Verdict.PURE_ROTATION.advice in result_text(facts)


@pytest.mark.parametrize("name", ["", "missing", "a\0b", "synth:room"])
def test_other_places_are_no_results(tmp_path, name):
    (tmp_path / "rgb.txt").write_text("")
    assert not is_result_folder(tmp_path / name)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (None, "run again"),
        ("", "damaged"),
        ("[" * 100_000, "damaged"),
        ("[]", "damaged"),
        ("{}", "attempts"),
        ({"keyframes": [{"frame": "x"}]}, "damaged"),
        ({"keyframes": 7}, "damaged"),
        ({"provenance": [3]}, "damaged"),
        ({"attempts": [{"window": {"risk": "high"}}]}, "damaged"),
    ],
)
def test_a_damaged_summary_is_one_line(tmp_path, content, word):
    folder = written(tmp_path / "out", make_result(make_map()))
    path = folder / "summary.json"
    if content is None:
        path.unlink()
    else:
        text = content if isinstance(content, str) else json.dumps(json.loads(path.read_text()) | content)
        path.write_text(text)
    with pytest.raises(SourceError, match=word) as raised:
        read_result(folder)
    assert "\n" not in str(raised.value)


def test_a_summary_that_leads_out_of_the_folder_is_not_read(tmp_path):
    folder = written(tmp_path / "out", make_result(make_map()))
    (folder / "summary.json").rename(tmp_path / "elsewhere.json")
    (folder / "summary.json").symlink_to(tmp_path / "elsewhere.json")
    with pytest.raises(SourceError, match="leads out"):
        read_result(folder)


def test_hostile_texts_and_numbers_are_escaped_or_left_out(tmp_path):
    folder = written(tmp_path / "out", make_result(make_map()))
    path = folder / "summary.json"
    fields = json.loads(path.read_text())
    fields["notes"] = ["a\nforged\x1b[2J"]
    fields["attempts"][-1]["window"]["risk"] = float("inf")
    path.write_text(json.dumps(fields))
    facts = read_result(folder)
    assert facts["risk"] is None
    assert r"a\nforged\x1b[2J" in result_text(facts)


def test_the_result_that_a_run_replaces_is_named(tmp_path):
    assert earlier_result(tmp_path / "none") is None
    folder = written(tmp_path / "out", make_result(make_map()))
    assert earlier_result(folder) == "the result of arc, initialized after 22 frames"
    (folder / "summary.json").write_text("{}")
    assert earlier_result(folder) is None
