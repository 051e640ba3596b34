"""A comparison gives the same results on every backend, and after it was killed and resumed."""

import csv
import json
from dataclasses import replace

import pytest
from comparisons import METHODS, SOURCES, rows_of, without_times
from path_types import PATH_TYPES
from written import contents

from slam_init.compare.rows import COLUMNS
from slam_init.compare.run import compare
from slam_init.compare.trials import Settings
from slam_init.config import Config, KeyframeConfig
from slam_init.errors import OutputError


@pytest.fixture
def copied(finished, tmp_path):
    """A folder with the trials of a finished comparison and nothing else."""
    (tmp_path / "trials.jsonl").write_bytes((finished[0] / "trials.jsonl").read_bytes())
    return tmp_path


def test_results_hold_one_sorted_row_per_trial_with_the_documented_columns(finished, plan):
    out, summary = finished
    with (out / "results.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == COLUMNS
    assert header[:8] == [
        "source", "method", "start", "outcome", "reason", "frames_to_accept", "rotation_error_deg",
        "direction_error_deg",
    ]  # fmt: skip
    keys = [(row[0], row[1], int(row[2])) for row in rows]
    assert keys == sorted(trial.key for trial in plan.trials())
    assert summary.trials == len(rows) == len(SOURCES) * len(METHODS)


def test_the_summary_counts_the_rows(finished):
    out, summary = finished
    assert json.loads((out / "summary.json").read_text()) == summary.as_dict()
    rows = [row for row in rows_of(out) if row["group"] != "points:rotation"]
    for method, figures in summary.parts["points_moving"].items():
        outcomes = [row["outcome"] for row in rows if row["method"] == method]
        for outcome in ("correct", "false", "none", "error"):
            assert getattr(figures, outcome) == outcomes.count(outcome)


def test_no_map_of_a_rotation_only_camera_is_correct_and_its_cause_is_recorded(finished):
    out, _ = finished
    rows = [row for row in rows_of(out) if row["group"] == "points:rotation"]
    assert {row["outcome"] for row in rows} <= {"none", "false", "error"}
    assert {row["injected_cause"] for row in rows} == {"pure_rotation"}


def test_loky_gives_the_same_results(plan, finished, tmp_path):
    summary = compare(plan, tmp_path, backend="loky", jobs=1)
    assert rows_of(tmp_path) == rows_of(finished[0])
    assert without_times(summary.as_dict()) == without_times(finished[1].as_dict())


def test_dask_gives_the_same_results(plan, finished, tmp_path):
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        compare(plan, tmp_path, backend=f"dask:{cluster.scheduler_address}")
    assert rows_of(tmp_path) == rows_of(finished[0])


def test_a_killed_run_is_resumed_and_ends_with_the_same_results(plan, finished, tmp_path):
    lines = (finished[0] / "trials.jsonl").read_bytes().splitlines(keepends=True)
    incomplete_line = lines[4][: len(lines[4]) // 2]
    (tmp_path / "trials.jsonl").write_bytes(b"".join(lines[:4]) + incomplete_line)
    compare(plan, tmp_path, backend="sequential")
    assert rows_of(tmp_path) == rows_of(finished[0])
    # finished trials are not run again
    assert (tmp_path / "trials.jsonl").read_bytes().startswith(b"".join(lines[:4]))


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_a_finished_comparison_is_narrowed_without_running_a_trial(plan, copied, path_type):
    before = (copied / "trials.jsonl").read_bytes()
    summary = compare(replace(plan, methods=METHODS[:1]), path_type(copied), backend="sequential")
    assert (copied / "trials.jsonl").read_bytes() == before
    assert summary.trials == len(SOURCES)


def test_rows_of_another_seed_are_not_mixed_in(plan, copied):
    with pytest.raises(OutputError, match="seed 0, not 1"):
        compare(replace(plan, settings=Settings(seed=1)), copied, backend="sequential")


def test_rows_of_other_options_are_not_mixed_in(plan, copied):
    other = Config(keyframes=KeyframeConfig(window=1))
    with pytest.raises(OutputError, match="other options"):
        compare(replace(plan, settings=Settings(config=other)), copied, backend="sequential")


def test_a_folder_of_a_version_with_other_options_is_not_resumed(plan, finished, tmp_path):
    header, *rows = (finished[0] / "trials.jsonl").read_text().splitlines(keepends=True)
    stored = json.loads(header)
    stored["options"]["acceptance"]["max_direction_error_deg"] = 10.0
    (tmp_path / "trials.jsonl").write_text("".join([json.dumps(stored) + "\n", *rows]))
    with pytest.raises(OutputError, match="other options"):
        compare(plan, tmp_path, backend="sequential")


def test_rows_without_their_criteria_are_kept_and_rows_of_other_criteria_are_run_again(plan, finished, tmp_path):
    header, *rows = (finished[0] / "trials.jsonl").read_text().splitlines()
    stored = [json.loads(row) for row in rows]
    for values in stored:
        del values["judged_by"]
    stored[0]["judged_by"] = "rotation within 1 deg"
    (tmp_path / "trials.jsonl").write_text("\n".join([header, *map(json.dumps, stored)]) + "\n")
    compare(plan, tmp_path, backend="sequential")
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == len(rows) + 2
    without = [{k: v for k, v in row.items() if k != "judged_by"} for row in rows_of(finished[0])]
    assert [{k: v for k, v in row.items() if k != "judged_by"} for row in rows_of(tmp_path)] == without


def test_the_summary_tells_the_wait_and_how_each_scene_is_judged(finished):
    summary = finished[1].as_dict()
    assert summary["min_left"] == 3
    assert summary["judging"]["points:room"]["truth"] == "sound"
    assert summary["judging"]["points:rotation"]["no_translation"]
    assert [item["second"] for item in summary["waits"]["points_moving"]] == list(METHODS[1:])
    value, low, high = summary["waits"]["points_moving"][0]["difference_frames"]
    assert low <= value <= high
    raises = summary["parts"]["points_moving"][METHODS[-1]]
    assert raises["wait"][0] == 4  # five frames: the limit of a trial that fails
    assert summary["parts"]["points_static"][METHODS[0]]["wait"] == [None, None, None]


def test_rows_of_another_version_are_not_mixed_in(plan, finished, tmp_path):
    header, *rows = (finished[0] / "trials.jsonl").read_text().splitlines()
    old = [{k: v for k, v in json.loads(row).items() if k != "kept_truth"} for row in rows]
    lines = [json.loads(header) | {"schema": 1}, *old]
    (tmp_path / "trials.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(OutputError, match="another version"):
        compare(plan, tmp_path, backend="sequential")


def test_a_comparison_that_fails_leaves_the_earlier_tables(plan, finished, tmp_path, monkeypatch):
    for name in ("trials.jsonl", "results.csv", "summary.json", "report.html"):
        (tmp_path / name).write_bytes((finished[0] / name).read_bytes())
    before = contents(tmp_path)
    monkeypatch.setattr("slam_init.compare.run.summary_of", full)
    with pytest.raises(OutputError, match="No space left on device: make room"):
        compare(replace(plan, methods=METHODS[:1]), tmp_path, backend="sequential")
    assert contents(tmp_path) == before


def full(*_, **__):
    raise OSError(28, "No space left on device")


def test_a_folder_of_another_program_is_refused(plan, tmp_path):
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        compare(plan, tmp_path, backend="sequential")
    assert contents(tmp_path, hidden=True) == {"report.html": b"mine"}
