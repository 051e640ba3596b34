"""The benchmark of wrong calibrations: what it draws, and how it counts."""

import json
from dataclasses import asdict, replace

import pytest

from tests.benchmarks.wrong_calibration import Case, drawn, read_log, report


def test_right_and_wrong_focal_lengths_are_drawn_in_their_ranges():
    for seed in range(20):
        assert abs(drawn(seed, is_wrong=False)[2] - 1) <= 0.01
        scene, source, stated = drawn(seed, is_wrong=True)
        assert 0.5 <= stated <= 0.93 or 1.08 <= stated <= 2
        assert source.camera.fx / source.sequence.true_camera.fx == pytest.approx(stated)
        assert source.sequence.name == scene


def test_the_tables_count_what_is_named_of_what_the_tracks_tell(tmp_path):
    right = Case(1, "room", "structure", 1.0, is_wrong=False, initialized=True, frames=5, named=False)
    unnamed = replace(right, stated=1.3, is_wrong=True)
    named = replace(unnamed, named=True, told=True, estimated=1.02, sigma=0.03, fits=[(1.02, 0.03, 2)])
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(asdict(one)) + "\n" for one in (right, unnamed, named)), encoding="utf-8")
    cases = read_log(log)
    assert report(cases).splitlines()[1:] == report([right, unnamed, named]).splitlines()[1:]
    (line,) = (line for line in report(cases).splitlines() if line.startswith("| all"))
    shares = [cell.strip().partition(";")[0] for cell in line.split("|")[2:5]]
    assert shares == ["100.0 % (1 of 1", "50.0 % (1 of 2", "0.0 % (0 of 1"]
