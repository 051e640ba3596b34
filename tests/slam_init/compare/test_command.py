"""The command ``slam-init compare``."""

import os
from pathlib import Path

import pytest
from comparisons import rows_of
from make_source import synth
from make_video import write_mp4

from slam_init.cli import main
from slam_init.compare.run import chosen_methods

pytestmark = pytest.mark.process

DATA_SET = "python:docs/examples/add_a_data_set.py:Poster"


def test_the_command_writes_tables_of_the_example_data_set_and_method(tmp_path, capsys):
    methods = ["quest", "add_a_method:MedianParallax"]
    options = ["--every", "30", "--min-left", "15", "--limit-frames", "16", "--jobs", "1"]
    assert main(["compare", DATA_SET, *options, "--methods", ",".join(methods), "--out", str(tmp_path)]) == 0
    assert "images, moving camera" in capsys.readouterr().out
    rows = rows_of(tmp_path)
    assert [(row["source"], row["method"], row["outcome"]) for row in rows] == [
        (DATA_SET, method, "correct") for method in sorted(methods)
    ]


def test_errors_of_a_method_are_named_and_its_edited_file_is_run_again(tmp_path, capsys):
    method, example = tmp_path / "mine.py", Path("docs/examples/add_a_method.py").read_text(encoding="utf-8")
    words = ["compare", "points:room", "--every", "30", "--jobs", "1", "--out", str(tmp_path / "out")]
    words += ["--methods", f"{method}:MedianParallax"]
    method.write_text(example.replace("count = check_matches", "count = 1 / 0, check_matches"), encoding="utf-8")
    assert main(words) == 0
    assert "trials that ended in an error: 1, the first: ZeroDivisionError" in capsys.readouterr().out
    method.write_text(example, encoding="utf-8")
    newer = (tmp_path / "out" / "trials.jsonl").stat().st_mtime + 1
    os.utime(method, (newer, newer))
    assert main(words) == 0
    assert "ended in an error" not in capsys.readouterr().out


def test_by_default_each_installed_method_is_compared_under_one_name():
    names = chosen_methods(None)
    assert "essential-5pt" in names and "magsac" not in names


def test_a_wrong_command_is_reported_in_one_line(tmp_path, capsys):
    options = ("--methods magic", "--methods stella,stella", "--backend spark", "--jobs 0", "--min-left 1")
    options = [f"points:room {option}" for option in (*options, "--camera fov=60", "--suite simulated")]
    for words in ("", *options, "--suite simulated --every 3", "--suite own", "nowhere", "python:nowhere:nothing"):
        assert main(["compare", *words.split(), "--out", str(tmp_path / "out")]) == 2
        message = capsys.readouterr().err
        assert message.startswith("slam-init: error: ") and message.count("\n") == 1


def test_a_missing_package_of_the_extra_is_reported_with_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("slam_init.compare.run.find_spec", lambda name: None if name == "pebble" else name)
    assert main(["compare", "points:room", "--methods", "quest", "--out", str(tmp_path / "out")]) == 2
    assert 'pip install "slam-init[compare]"' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_video_is_compared_with_a_given_camera(tmp_path, capsys):
    source = synth("room", width=160, height=120)
    write_mp4(tmp_path / "v.mp4", [frame.image for frame in source.frames(0, 4)])
    words = ["compare", str(tmp_path / "v.mp4"), "--methods", "stella", "--jobs", "1", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert "give --camera FILE" in capsys.readouterr().err
    assert main([*words, "--camera", "fov=60"]) == 0
    assert [row["evaluated_by"] for row in rows_of(tmp_path / "out")] == ["not evaluated"]
