"""The benchmark of the audit: maps are judged by the truth, and the table counts what was found."""

from dataclasses import replace

from tests.benchmarks.audit import Judged, main, report, run
from tests.benchmarks.reliability import built_in

RIGHT = Judged("simulated", {"scene": "room"}, 0, "poselib", False, False, 0.1, 2.0, "sound", 0.002, "sound", 0.002)
FALSE = replace(RIGHT, false=True, direction_deg=40.0, verdict="doubtful", verdict_later="wrong", risk_later=1.0)


def rows(text):
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return {cells[0]: cells[1:] for cells in ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)}


def test_false_maps_that_are_not_sound_are_found():
    missed, alarm = replace(FALSE, verdict="sound", verdict_later="sound"), replace(RIGHT, verdict="wrong")
    counted = rows(report([RIGHT, alarm, FALSE, missed]))["all"]
    assert counted[:2] == ["2", "1 / 1"]
    assert counted[3:7] == ["0 / 1", "2", "1 / 2", "1 / 0"]


def test_stated_risks_are_set_against_the_false_maps():
    counted = rows(report([RIGHT, FALSE, replace(FALSE, risk_later=0.9)]))
    assert counted["0 to 0.005"][:3] == ["1", "0.00", "0"]
    assert counted["0.8 to 1"][:3] == ["2", "1.90", "2"]


def test_each_map_is_a_line_of_the_log(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.benchmarks.audit.METHODS", ("colmap", "essential-5pt"))
    world = next(one for one in built_in(0) if one.factors["scene"] == "room" and one.factors["baseline"] == 0.1)
    found = run([("simulated", 0, world)], tmp_path / "log.jsonl")
    assert found and all(0 < one.risk <= 1 for one in found)
    assert main(["--from-log", str(tmp_path / "log.jsonl"), "--out", str(tmp_path / "table.md")]) == 0
    assert rows((tmp_path / "table.md").read_text())["all"] == rows(report(found))["all"]
