"""The protocol of InitBench: fixed worlds, frozen tracks, a sheet that repeats itself, a page that trusts nothing."""

import json
import math
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

from slam_init.bench.command import Execution, list_text, run_bench
from slam_init.bench.leaderboard import leaderboard_html, publish, read_entries
from slam_init.bench.protocol import DEFAULTS, DRAWN_OPTIONS, Run, check_frozen, rendered_worlds, simulated_worlds
from slam_init.cli import main
from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.compare.statistics import Interval
from slam_init.errors import SourceError

RUN = Run("drawn", 6, 0, DEFAULTS["drawn"].every, (), ("stella", "essential-8pt"))


def without_times(text):
    """A sheet without its columns of milliseconds and without the machine."""
    sheet = json.loads(text)
    return {name: value for name, value in sheet.items() if name not in ("times", "machine")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench") / "out"
    return out, run_bench(RUN, out, Execution(backend="sequential"))


def test_a_shorter_suite_is_a_part_of_a_longer_one_and_seeds_share_no_world():
    for worlds in (simulated_worlds, rendered_worlds):
        assert worlds(30, 0)[:7] == worlds(7, 0)
        assert not set(worlds(50, 0)) & set(worlds(50, 1))


def test_each_option_of_the_worlds_is_drawn_evenly():
    worlds = simulated_worlds(1000, 0)
    for name, values in DRAWN_OPTIONS.items():
        counts = [sum(f"{name}={value}&" in world for world in worlds) for value in values]
        assert sum(counts) == 1000
        assert max(abs(np.array(counts) - 1000 / len(values))) < 5 * np.sqrt(1000 / len(values))


def test_the_tracks_of_the_worlds_are_the_frozen_ones():
    digests = {}
    for text in simulated_worlds(1000, 0)[:1000:97]:
        source = open_compared(text)
        digests[text] = tracks_digest(source, replay(source, text, 0, ""))
    check = check_frozen("drawn", digests)
    assert (check.same, check.different, check.unknown) == (len(digests), (), 0)


def test_other_tracks_and_unknown_sources_are_told():
    known = simulated_worlds(1, 0)[0]
    check = check_frozen("drawn", {known: "0" * 16, "points:room?seed=77": "1" * 16})
    assert check.different == (known,) and check.unknown == 1
    assert "other tracks" in check.text


def test_a_digest_changes_with_the_tracks_and_not_with_the_last_bit():
    source = open_compared("points:room?views=4&seed=1")
    steps = list(replay(source, "", 0, ""))
    digest = tracks_digest(source, steps)

    def moved(by):
        current = steps[2].current
        return [*steps[:2], replace(steps[2], current=replace(current, pixels=current.pixels + by)), steps[3]]

    assert tracks_digest(source, moved(1e-12)) == digest
    assert tracks_digest(source, moved(0.5)) != digest
    assert tracks_digest(source, steps[:3]) != digest


def test_a_second_run_gives_the_same_sheet_but_for_times(finished, tmp_path):
    out, _ = finished
    run_bench(RUN, tmp_path / "again", Execution(backend="sequential"))
    first, second = ((folder / "sheet.json").read_text() for folder in (out, tmp_path / "again"))
    assert without_times(first) == without_times(second)


def test_the_sheet_tells_its_command_and_that_of_each_row(finished):
    out, text = finished
    sheet = json.loads((out / "sheet.json").read_text())
    assert sheet["command"] == "slam-init bench --suite drawn --worlds 6 --methods stella,essential-8pt"
    assert sheet["rows"][0]["command"] == "slam-init bench --suite drawn --worlds 6 --methods stella"
    assert "6 worlds in place of 1000" in text and "frozen tracks" in text
    assert (out / "sheet.md").read_text() in text


def test_the_figures_of_the_sheet_are_counts_of_the_trials(finished):
    out, _ = finished
    sheet = json.loads((out / "sheet.json").read_text())
    rows = [json.loads(line) for line in (out / "trials.jsonl").read_text().splitlines()[1:]]
    for scores in sheet["rows"]:
        of_method = [row for row in rows if row["method"] == scores["method"]]
        solvable = [row for row in of_method if row["judged_by"] != "every map is false"]
        assert (scores["trials"], scores["solvable"]) == (len(of_method), len(solvable))
        correct = sum(row["outcome"] == "correct" for row in solvable) / len(solvable)
        assert scores["correct"][0] == pytest.approx(correct, abs=1e-6)
        assert scores["false_maps"] == sum(row["outcome"] == "false" for row in of_method)
        assert scores["correct"][1] <= correct <= scores["correct"][2]
    by_kind = {one["kind"]: one for one in sheet["strata"] if one["value"] is None}
    assert sum(one["cells"][0]["trials"] for one in by_kind.values()) == 6
    assert set(by_kind) <= {"general", "plane", "no translation"}


@pytest.mark.parametrize("method", ["stella", "a=command:sh x.sh {images} {out}", "command:sh 'a,b' {images} {out}"])
def test_the_words_of_a_command_line_give_the_run_back(method):
    run = Run("video", 0, 3, 7, ("a", "b"), ("quest", method))
    words = shlex.split(shlex.join(run.words()))
    given = words[words.index("--methods") + 1].split(",")
    given += [words[i + 1] for i, word in enumerate(words) if word == "--method"]
    assert tuple(given) == run.methods
    assert words[words.index("--sequences") + 1] == "a,b"


def test_the_page_ranks_the_rows_of_equal_protocols_and_loads_nothing(finished, tmp_path):
    out, _ = finished
    assert "2 rows of 1 runs" in publish([str(out)], tmp_path / "page")
    page = (tmp_path / "page" / "leaderboard.html").read_text()
    for outside in ("http://", "https://", "<script src", "<link", "@import", "url("):
        assert outside not in page
    entries = read_entries(str(out))
    assert len({entry.group for entry in entries}) == 1
    order = re.findall(r'<th scope="row"[^>]*>([^<]*)<', page)
    assert order == [one.row.label for one in sorted(entries, key=lambda one: (-one.score, one.row.label))]
    assert page.count('class="board"') == 1 and "10 times that of false maps" in page


def test_a_false_map_costs_more_than_none(finished):
    entry = read_entries(str(finished[0]))[0]
    shares = {"waits": (Interval(0.6, 0.5, 0.7), Interval(0.0, 0.0, 0.1))}
    shares |= {"answers": (Interval(0.9, 0.8, 1.0), Interval(0.04, 0.0, 0.1))}
    waits, answers = (
        replace(entry, row=replace(entry.row, label=label, correct=correct, false=false))
        for label, (correct, false) in shares.items()
    )
    order = re.findall(r'<th scope="row"[^>]*>([^<]*)<', leaderboard_html([answers, waits]))
    assert order == ["waits", "answers"]


def test_the_page_and_the_report_of_a_run_tell_the_same_false_rates(finished):
    out, _ = finished
    summary = json.loads((out / "summary.json").read_text())
    for entry in read_entries(str(out)):
        figures = [part[entry.row.label] for part in summary["parts"].values() if entry.row.label in part]
        assert sum(one["false"] for one in figures) == entry.outcomes[1]
        judged = sum(one["trials"] - one["accepted"] + one["correct"] + one["false"] for one in figures)
        assert entry.row.false.value == pytest.approx(entry.outcomes[1] / judged)
        assert sum(entry.outcomes) == entry.row.trials


def test_a_text_in_a_sheet_is_escaped(finished):
    entry = read_entries(str(finished[0]))[0]
    row = replace(entry.row, label="<script>alert(1)</script>", command="<b>", about='"><i>')
    page = leaderboard_html([replace(entry, row=row)])
    for hostile in ("<script>alert", "<b><", '"><i>'):
        assert hostile not in page


@pytest.mark.parametrize(
    "change",
    [
        lambda sheet: sheet.pop("rows"),
        lambda sheet: sheet["rows"][0].pop("correct"),
        lambda sheet: sheet["rows"][0].update(correct="much"),
        lambda sheet: sheet["rows"][0].update(label=5),
        lambda sheet: sheet["rows"][0].update(correct=["nan", "inf", 1]),
        lambda sheet: sheet["rows"][0].update(false=[math.nan, 0, 1]),
        lambda sheet: sheet["rows"][0].update(delay=[math.inf, 0, 1]),
        lambda sheet: sheet["times"]["stella"].update(frame_ms="inf"),
        lambda sheet: sheet.update(version=99),
        lambda sheet: sheet.update(suite="own"),
        lambda sheet: sheet.update(rows=7),
    ],
)
def test_a_damaged_sheet_is_told_in_one_line(finished, tmp_path, change):
    sheet = json.loads((finished[0] / "sheet.json").read_text())
    change(sheet)
    (tmp_path / "sheet.json").write_text(json.dumps(sheet))
    with pytest.raises(SourceError, match=r"damaged|no score sheet") as error:
        read_entries(str(tmp_path))
    assert "\n" not in str(error.value)


def test_a_sheet_that_is_a_link_out_of_its_folder_is_not_followed(finished, tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "sheet.json").symlink_to(finished[0] / "sheet.json")
    with pytest.raises(SourceError, match="leads out of the folder"):
        read_entries(str(tmp_path / "theirs"))


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["publish"], "needs folders"),
        (["publish", "no-such-folder"], "has no sheet.json"),
        (["nothing"], "unknown action"),
        (["convert", "7scenes"], "a layout and a folder"),
        (["convert", "own", "."], "unknown layout"),
        (["convert", "parrington", "."], "no program converts"),
        (["--worlds", "0"], "at least 1"),
        (["--every", "3"], "belongs to"),
        (["--suite", "video", "--worlds", "3"], "belongs to"),
        (["--sequences", "a"], "belongs to"),
        (["--methods", "no-such-method"], "unknown method"),
        (["--methods", "stella", "--method", "a=command:sh {images}"], "lacks {out}"),
        (["--methods", "stella", "--method", "stella"], "twice"),
    ],
)
def test_wrong_words_end_in_one_line(arguments, cause, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *arguments]) == 2
    told = capsys.readouterr().err
    assert cause in told and told.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_without_a_folder_of_sequences_the_list_tells_where_to_get_each(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("SLAM_INIT_DATA", raising=False)
    assert "set SLAM_INIT_DATA" in list_text()
    assert main(["bench", "--suite", "video"]) == 2
    assert "set SLAM_INIT_DATA" in capsys.readouterr().err
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert list_text().count("https://") >= 14
    assert main(["bench", "--suite", "video"]) == 2
    assert "no sequence of the benchmark" in capsys.readouterr().err
