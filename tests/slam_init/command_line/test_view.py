"""``slam-init view`` and ``slam-init info`` of a result folder: what they open, tell and refuse."""

import json

import pytest
from make_map import make_map, make_result
from make_summary import summarize, write_results

import slam_init.recording.viewer as viewer
from slam_init.cli import main

RECORDING = b"RRF2 recording"
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def folder(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "recording.rrd").write_bytes(RECORDING)
    return out


@pytest.fixture
def shown(monkeypatch):
    """Stands in for the viewer: notes what it is asked for."""
    calls = []

    def screenshots(path, frames, window):
        calls.append(("screenshot", path.name, tuple(frames), window))
        return {9 if frame == -1 else frame: PNG + bytes([frame % 251]) for frame in frames}

    monkeypatch.setattr(viewer, "show", lambda path: calls.append(("window", path.name)))
    monkeypatch.setattr(viewer, "serve", lambda path, port: calls.append(("web", path.name, port)))
    monkeypatch.setattr(viewer, "screenshots", screenshots)
    monkeypatch.setenv("DISPLAY", ":0")
    return calls


def test_the_recording_of_a_folder_is_opened_in_a_window_or_served(folder, shown, capsys):
    assert main(["view", "out"]) == 0
    assert main(["view", "out/recording.rrd", "--web", "--port", "8123"]) == 0
    assert shown == [("window", "recording.rrd"), ("web", "recording.rrd", 8123)]
    assert "Ctrl+C ends" in capsys.readouterr().out


def test_the_recording_of_an_interrupted_run_is_opened_too(folder, shown):
    (folder / "recording.rrd").rename(folder / "interrupted.rrd")
    assert main(["view", "out"]) == 0
    assert shown == [("window", "interrupted.rrd")]


def test_without_a_display_the_ways_are_reported(folder, shown, monkeypatch, capsys):
    monkeypatch.setattr(viewer, "has_display", lambda: False)
    assert main(["view", "out"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(way in error for way in ("--web", "--screenshot", "rerun recording.rrd"))
    assert shown == []


def test_screenshots_are_one_file_for_each_frame_and_replace_pictures_only(folder, shown, tmp_path, capsys):
    assert main(["view", "out", "--screenshot"]) == 0
    assert (tmp_path / "slam-init-view.png").read_bytes().startswith(PNG)
    assert main(["view", "out", "--screenshot", "a.png", "--at", "7,3", "--size", "800x600"]) == 0
    assert sorted(file.name for file in tmp_path.glob("a*")) == ["a-000003.png", "a-000007.png"]
    assert main(["view", "out", "--screenshot", "a.png", "--at", "3"]) == 0
    assert main(["view", "out", "--screenshot", "a.png", "--at", "3"]) == 0  # its own picture is replaced
    assert shown[1] == ("screenshot", "recording.rrd", (3, 7), "800x600")
    assert shown[2] == ("screenshot", "recording.rrd", (3,), "1280x720")
    (tmp_path / "thesis.txt").write_text("mine")
    capsys.readouterr()
    assert main(["view", "out", "--screenshot", "thesis.txt"]) == 2
    assert "no PNG" in capsys.readouterr().err
    assert (tmp_path / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["missing"], "no such folder"),
        (["empty"], "holds no recording"),
        (["garbage.rrd"], "not a rerun recording"),
        (["out", "--at", "3"], "--screenshot"),
        (["out", "--port", "3"], "--web"),
        (["out", "--web", "--port", "70000"], "65535"),
        (["out", "--screenshot", "--at", "-1"], "--at"),
        (["out", "--screenshot", "--size", "1x1"], "--size"),
        (["out", "--screenshot", "nowhere/a.png"], "no folder"),
        (["out", "--screenshot", "empty"], "a folder, not a file"),
        (["out", "--web", "--screenshot"], "not allowed with"),
    ],
)
def test_what_cannot_be_shown_is_one_line(folder, shown, tmp_path, capsys, arguments, word):
    (tmp_path / "empty").mkdir()
    (tmp_path / "garbage.rrd").write_bytes(b"garbage")
    assert main(["view", *arguments]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert error.count("\n") == 1
    assert shown == []


def test_info_describes_a_result_folder(tmp_path, capsys):
    result = make_result(make_map())
    write_results(tmp_path / "out", result, summarize(result))
    assert main(["info", "out"]) == 0
    text = capsys.readouterr().out
    assert "out: initialized after 22 frames" in text
    assert "trajectory.txt" in text
    assert main(["info", "out", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["keyframes"] == [10, 17, 24, 31]
    (tmp_path / "out" / "summary.json").write_text("{")
    assert main(["info", "out"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
