"""The log of windows is read as it was written, and the tables count what the log holds."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise

import pytest

from slam_init.errors import SlamInitError
from slam_init.types.comparison import Margin
from slam_init.window.risk import WindowRisk
from slam_init.window.uncertainty import CameraEstimate, DistortionEstimate, FocalEstimate, ReadoutEstimate
from tests.benchmarks import window_fit
from tests.benchmarks.window_fit import Clip, World, clips_of, run, worlds_of
from tests.benchmarks.window_log import Accuracy, Window, read_log, write_log
from tests.benchmarks.window_tables import (
    RISK_BINS,
    coverage_table,
    exchange_table,
    nees_table,
    reliability_table,
    rule_table,
)

RISK = WindowRisk(
    total=0.003,
    direction=0.001,
    rival=0.001,
    rotation=0.0005,
    moving=0.0,
    floor=0.0005,
    direction_sigma_deg=1.25,
    rotation_sigma_deg=0.1,
    direction_with_known_lens=0.0009,
    direction_if_rigid=0.0009,
    depth_sigma=0.2,
    field_px=1 / 3,
    camera=CameraEstimate(FocalEstimate(0.01, 0.03), DistortionEstimate(0.01, 0.02), None),
    margin=Margin(30.0, 5.0),
    rotation_log_likelihood=200.0,
    direction_of_views=(0.001, 0.02),
    moving_tracks=(3, 17),
)
GOOD = Accuracy(0.1, 2.0, 3.0, 1.0, 0.9, 100, 95, 1.1, 0.4549)


def window(total=0.003, accuracy=GOOD, scene="room", views=5, start="1"):
    return Window(scene, 0.05, start, views, "general", replace(RISK, total=total), accuracy, 12.5)


def rows(table):
    """Cells of a table, without its two lines of heading."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_a_log_is_read_as_it_was_written(tmp_path):
    rolling = replace(RISK.camera, readout=ReadoutEstimate(0.03, 0.001))
    others = [replace(RISK, margin=None, direction_of_views=()), replace(RISK, camera=rolling)]
    windows = [window(), window(1 / 7), *(replace(window(), risk=risk) for risk in others)]
    assert list(write_log(tmp_path / "log", windows)) == windows
    assert list(read_log(tmp_path / "log")) == windows


def test_figures_that_are_not_finite_are_null_in_the_log(tmp_path):
    no_motion = Window("wall", 0.05, "1", 2, "none", None)
    far = replace(window(), risk=replace(RISK, depth_sigma=math.inf))
    list(write_log(tmp_path / "log", [no_motion, far]))
    first, second = map(json.loads, (tmp_path / "log").read_text().splitlines())
    assert first["risk"] is first["accuracy"]["rotation_deg"] is second["risk"]["depth_sigma"] is None
    read = list(read_log(tmp_path / "log"))
    assert read[0].risk is None
    assert math.isnan(read[0].accuracy.rotation_deg)
    assert math.isnan(read[1].risk.depth_sigma)
    assert read[0].wrong


@pytest.mark.parametrize("line", ["no json", "{}", "[1]", '{"risk": null, "accuracy": {"unknown": 1}}'])
def test_a_line_that_is_no_window_is_named(tmp_path, line):
    list(write_log(tmp_path / "log", [window()]))
    with (tmp_path / "log").open("a") as file:
        file.write(line + "\n")
    with pytest.raises(SlamInitError, match="line 2 is no window"):
        list(read_log(tmp_path / "log"))


def test_each_risk_is_in_one_bin_of_the_reliability():
    assert RISK_BINS[0][0] == 0
    assert RISK_BINS[-1][1] == 1
    assert all(a[1] == b[0] for a, b in pairwise(RISK_BINS))
    risks = [0.0, 0.0006, 0.001, 0.002, 0.005, 0.02, 0.05, 0.5, 1.0]
    counts = [int(row[1]) for row in rows(reliability_table([window(risk) for risk in risks]))]
    assert counts == [1, 1, 1, 1, 1, 1, 1, 2]


def test_the_reliability_counts_wrong_windows():
    wrong = replace(GOOD, direction_deg=15.1)
    found = rows(reliability_table([window(0.01), window(0.01, wrong), window(0.01, replace(GOOD, rotation_deg=5.1))]))
    assert found[4][1] == "3"
    assert found[4][3] == "2"
    assert found[4][4] == "66.67"


def test_a_smaller_risk_waits_longer_and_is_less_often_wrong():
    wrong = replace(GOOD, direction_deg=30.0)
    first = [window(0.03, wrong, views=2, start="1"), window(0.003, views=4, start="1")]
    second = [window(0.004, views=3, start="2"), window(0.0015, views=6, start="2")]
    found = {row[0]: (row[1], row[3]) for row in rows(exchange_table([*first, *second]))}
    assert found["0.05"] == ("1/1/0", "3.00")
    assert found["0.02"] == found["0.005"] == ("2/0/0", "2.50")
    assert found["0.002"] == ("1/0/1", "4.50")
    assert found["0.001"] == ("0/0/2", "5.00")


def test_coverage_is_that_of_chi_square_and_of_tracks():
    out = Accuracy(0.1, 2.0, 7.9, 6.0, 5.9, 300, 100, 3.0, 2.0)
    found = rows(coverage_table([window(), window(accuracy=out)]))
    assert found[0] == ["room", "2", "50.0", "50.0", "100.0", "48.8", "64.2"]
    assert found[1][0] == "all"


def test_nees_of_the_expected_size_is_one():
    exact = Accuracy(0.1, 2.0, 3.0, 2.0, 2.0, 100, 95, 1.0, 0.4549)
    found = rows(nees_table([window(accuracy=exact)], lambda w: w.scene, "scene"))[0]
    assert [cell.split(" / ")[0] for cell in found[2:]] == ["1.00"] * 4


def test_the_rule_takes_the_first_window_of_a_trial():
    windows = [window(0.1, views=2), window(0.004, views=3), window(0.001, views=4), window(0.9, views=2, start="2")]
    assert rows(rule_table(windows, 0.005))[0][:3] == ["room 0.05", "1/0/1", "2.0"]


def same_but_for_the_time(windows):
    return [replace(one, milliseconds=0.0) for one in windows]


def test_a_world_is_judged_alike_from_its_log_and_in_any_process(tmp_path):
    worlds = worlds_of(range(2), [0.1], ["room"])
    assert worlds == [World("room", 0.1, 0), World("room", 0.1, 1)]
    windows = list(write_log(tmp_path / "log", run(worlds)))
    assert [(w.start, w.views) for w in windows] == [(str(seed), views) for seed in range(2) for views in range(2, 13)]
    read = list(read_log(tmp_path / "log"))
    assert repr(read) == repr(windows)
    assert repr(same_but_for_the_time(run(worlds, jobs=2))) == repr(same_but_for_the_time(windows))
    last = windows[-1]
    assert not last.wrong
    assert 0.8 * last.accuracy.depth_tracks < last.accuracy.depth_covered
    # At rest are 95 % of the tracks; a few leave the view.
    assert 150 < last.accuracy.depth_tracks <= 300


def test_a_camera_without_translation_has_one_baseline_and_no_right_direction():
    worlds = worlds_of(range(1), [0.03, 0.1], ["rotation", "room"])
    assert [(w.scene, w.baseline) for w in worlds] == [("rotation", 0.03), ("room", 0.03), ("room", 0.1)]
    assert all(w.wrong and math.isnan(w.accuracy.direction_nees) for w in run(worlds[:1]))


def test_the_clips_are_those_of_sound_sequences(tmp_path, monkeypatch):
    monkeypatch.setattr(window_fit, "find_sequences", lambda data: ["euroc/long", "7scenes/redkitchen_a", "short"])
    monkeypatch.setattr("slam_init.datasets.open_source", lambda text: range(30 if text.endswith("long") else 9))
    data = str(tmp_path)
    expected = [Clip(data, "euroc/long", 0), Clip(data, "euroc/long", 8), Clip(data, "euroc/long", 16)]
    assert clips_of(data, 8) == [*expected, Clip(data, "short", 0)]


def test_the_program_prints_the_tables_of_logs(tmp_path, capsys):
    for name in ("a", "b"):
        list(write_log(tmp_path / name, [window(start=name)]))
    assert (
        window_fit.main(["--from-log", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "out")]) == 0
    )
    printed = capsys.readouterr().out
    assert "2 windows, 2 with a proposed motion" in printed
    assert (tmp_path / "out").read_text() == printed
    assert window_fit.main(["--from-log", str(tmp_path / "none")]) == 2


def test_data_that_are_absent_are_skipped_with_a_line(tmp_path, capsys):
    arguments = ["--seeds", "0", "1", "--baselines", "0.1", "--scenes", "room", "--data", str(tmp_path / "absent")]
    assert window_fit.main(arguments) == 0
    shown = capsys.readouterr()
    assert "no real sequences below" in shown.err
    assert "## Drawn worlds" in shown.out
    assert "## Real sequences" not in shown.out
