"""What a folder of results shows of itself, and that a damaged one is one clear line."""

from __future__ import annotations

import json

import pytest
from make_map import make_map, make_result
from make_summary import summarize, write_results

from slam_init.errors import SourceError
from slam_init.output.report import earlier_result, is_result_folder, read_result, result_text
from slam_init.types.refusal import Verdict


def written(folder, result):
    write_results(folder, result, summarize(result), "seed = 0\n")
    return folder


def test_a_map_is_reported_with_its_keyframes_and_files(tmp_path):
    folder = written(tmp_path / "out", make_result(make_map()))
    assert is_result_folder(folder)
    facts = read_result(folder)
    assert [facts[name] for name in ("status", "reason", "risk")] == ["initialized", None, 0.004]
    assert facts["keyframes"] == [10, 17, 24, 31]
    assert {"name": "map.ply", "bytes": (folder / "map.ply").stat().st_size} in facts["files"]
    assert "initialized after 22 frames" in result_text(facts).splitlines()[0]
    assert "4 (frames 10, 17, 24, 31)" in result_text(facts) and "graph.txt" in result_text(facts)


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
