"""A comparison gives the same results after it was killed and resumed, refuses foreign rows, and has a page."""

import csv
import html
import json
import re
from collections import Counter
from dataclasses import replace

import pytest
from comparisons import METHODS, SOURCES, rows_of
from path_types import PATH_TYPES

from slam_init.compare.rows import COLUMNS
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Plan, Settings
from slam_init.errors import OutputError
from slam_init.output.folder import Marker
from slam_init.output.plain_json import plain

pytestmark = pytest.mark.process


@pytest.fixture
def copied(finished, tmp_path):
    """A folder with the trials of a finished comparison and nothing else."""
    trials_only(tmp_path, (finished[0] / "trials.jsonl").read_bytes())
    return tmp_path


def trials_only(folder, content):
    Marker("compare", frozenset({"trials.jsonl"})).write(folder)
    (folder / "trials.jsonl").write_bytes(content)


def test_results_hold_one_sorted_row_per_trial_with_the_documented_columns(finished, plan):
    out, summary = finished
    with (out / "results.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == list(COLUMNS)
    keys = [(row[0], row[1], int(row[2])) for row in rows]
    assert keys == sorted(trial.key for trial in plan.trials())
    assert summary["trials"] == len(rows) == len(SOURCES) * len(METHODS)


def test_the_summary_counts_the_rows_and_states_the_wait_and_how_each_scene_is_evaluated(finished):
    out, summary = finished
    stored = json.loads((out / "summary.json").read_text())
    assert stored == json.loads(json.dumps(plain(summary)))
    rows = [row for row in rows_of(out) if row["group"] != "points:rotation"]
    for method, figures in stored["parts"]["points_moving"].items():
        counts = Counter(row["outcome"] for row in rows if row["method"] == method)
        assert {name: figures[name] for name in ("correct", "false", "none", "error") if figures[name]} == counts
    assert stored["criteria"]["points:room"]["truth"] == "sound"
    assert stored["criteria"]["points:rotation"]["no_translation"]
    assert [item["second"] for item in stored["waits"]["points_moving"]] == list(METHODS[1:])
    assert stored["parts"]["points_moving"][METHODS[-1]]["wait"][0] == 4  # the limit of a trial that fails
    assert stored["parts"]["points_static"][METHODS[0]]["wait"] == [None, None, None]


def test_a_killed_run_is_resumed_and_ends_with_the_same_results(plan, finished, tmp_path):
    lines = (finished[0] / "trials.jsonl").read_bytes().splitlines(keepends=True)
    incomplete_line = lines[4][: len(lines[4]) // 2]
    trials_only(tmp_path, b"".join(lines[:4]) + incomplete_line)
    compare(plan, tmp_path)
    assert rows_of(tmp_path) == rows_of(finished[0])
    # finished trials are not run again
    assert (tmp_path / "trials.jsonl").read_bytes().startswith(b"".join(lines[:4]))


def test_a_finished_comparison_is_narrowed_without_running_a_trial(plan, copied):
    before = (copied / "trials.jsonl").read_bytes()
    for path_type in PATH_TYPES:
        summary, _ = compare(replace(plan, methods=METHODS[:1]), path_type(copied))
        assert (copied / "trials.jsonl").read_bytes() == before
        assert summary["trials"] == len(SOURCES)


def test_rows_of_other_settings_are_not_mixed_in(plan, copied):
    for settings, message in ((Settings(seed=1), "seed 0, not 1"), (Settings(audit=True), "audit None, not True")):
        with pytest.raises(OutputError, match=message):
            compare(replace(plan, settings=settings), copied)
    trials = copied / "trials.jsonl"
    trials.write_text(trials.read_text().replace('"options": {', '"options": {"of another version": 1, ', 1))
    with pytest.raises(OutputError, match="other options"):
        compare(plan, copied)


def test_the_page_loads_nothing_and_states_the_wait_and_how_each_scene_is_evaluated(finished):
    page = (finished[0] / "report.html").read_text()
    for message in (*METHODS, f"wait of {METHODS[0]} minus that of", "rotation within 5 deg", "every map is false"):
        assert message in page
    page = re.sub(r'xmlns(:\w+)?="[^"]*"|url\(#|href="#', "", page)
    for outside in ("http://", "https://", "<script", "<link", "@import", "url(", "src=", "href="):
        assert outside not in page


@pytest.mark.parametrize("source", ["points:rotation?views=12", "synth:pan?frames=24&width=320&height=240"])
def test_the_page_lists_each_false_map_with_a_command_to_look_at_it(source, tmp_path):
    """``run`` takes images alone."""
    compare(Plan(tuple(describe_sources([source])), ("homography",), every=6), tmp_path / "out")
    page = html.unescape(" ".join((tmp_path / "out" / "report.html").read_text().split()))
    starts = [row["start"] for row in rows_of(tmp_path / "out") if row["outcome"] == "false"]
    listed = page.partition('<h2 id="false">')[2].partition("<h2 ")[0]
    assert starts and listed.count('<th scope="row">') == len(starts)
    for start in starts:
        command = f'slam-init run "{source}" --start {start} --method homography'
        assert (command in listed) == source.startswith("synth:")


def test_a_comparison_without_any_map_has_a_page_as_well(tmp_path):
    plan = Plan(tuple(describe_sources(["points:static?views=3"])), ("failing_methods:Raises",))
    summary, _ = compare(plan, tmp_path / "out")
    assert summary["parts"]["points_static"]["failing_methods:Raises"]["error"] == 1
    assert (tmp_path / "out" / "report.html").is_file()
