"""A comparison gives the same results wherever it runs, however often it was killed, and whatever a method does."""

import csv
import json
import tracemalloc
from dataclasses import replace
from types import SimpleNamespace
from urllib.parse import parse_qsl

import numpy as np
import pytest
from make_scene import texture, window
from make_source import GivenFrames
from read_recording import entities, rerun_tool

from slam_init.cli import main
from slam_init.compare import trials
from slam_init.compare.aggregate import TrialTable, summary_of
from slam_init.compare.isolation import isolated_trial
from slam_init.compare.journal import Journal
from slam_init.compare.plan import Plan
from slam_init.compare.replay import find_tracks
from slam_init.compare.run import compare
from slam_init.compare.sources import (
    describe_sources,
    drawn_sources,
    focal_error_of,
    grid_sources,
    judging_of,
    open_compared,
)
from slam_init.compare.trials import COLUMNS, Settings, Trial
from slam_init.config import Config, KeyframeConfig, TrackingConfig
from slam_init.errors import ConfigError, OutputError, SourceError
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose
from slam_init.types.result import Attempt, Result

SOURCES = ("points:room?views=5&seed=1", "points:wall?views=5&seed=2", "points:rotation?views=5&seed=3")
METHODS = ("stella", "essential-8pt", "failing_methods:Raises")


@pytest.fixture(scope="module")
def plan():
    return Plan(tuple(describe_sources(SOURCES)), METHODS)


@pytest.fixture(scope="module")
def finished(plan, tmp_path_factory):
    """A comparison that nothing went wrong with."""
    out = tmp_path_factory.mktemp("compare") / "out"
    return out, compare(plan, out, backend="sequential", command="slam-init compare")


def rows_of(out):
    """The rows without what differs from run to run."""
    with (out / "results.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if not k.endswith(("_ms", "_mb"))} for row in csv.DictReader(file)]


def without_times(value):
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if not key.endswith(("_ms", "_mb"))}
    return [without_times(item) for item in value] if isinstance(value, list) else value


# -- results ---------------------------------------------------------------------------------------


def test_there_is_one_row_a_trial_sorted_with_the_stated_columns(finished, plan):
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
    assert summary["trials"] == len(rows) == len(SOURCES) * len(METHODS)


def test_the_summary_counts_the_rows(finished):
    out, summary = finished
    assert json.loads((out / "summary.json").read_text()) == summary
    rows = [row for row in rows_of(out) if row["group"] != "points:rotation"]
    for method, figures in summary["parts"]["points_moving"].items():
        outcomes = [row["outcome"] for row in rows if row["method"] == method]
        for outcome in ("correct", "false", "none", "error"):
            assert figures[outcome] == outcomes.count(outcome)


def test_no_map_of_a_turning_camera_is_correct_and_its_cause_is_known(finished):
    out, _ = finished
    rows = [row for row in rows_of(out) if row["group"] == "points:rotation"]
    assert {row["outcome"] for row in rows} <= {"none", "false", "error"}
    assert {row["injected_cause"] for row in rows} == {"pure_rotation"}


def test_the_page_stands_alone(finished):
    page = (finished[0] / "report.html").read_text()
    assert page.startswith("<!DOCTYPE html>")
    for outside in ("http://", "https://", "<script", "<link", "@import", "url("):
        assert outside not in page
    for method in METHODS:
        assert method in page


def test_the_tables_of_a_comparison_without_a_map_are_made_as_well(tmp_path):
    plan = Plan(tuple(describe_sources(["points:static?views=3"])), ("failing_methods:Raises",))
    summary = compare(plan, tmp_path / "out", backend="sequential")
    assert summary["parts"]["points_still"]["failing_methods:Raises"]["error"] == 1


# -- backends, resuming ----------------------------------------------------------------------------


def test_loky_gives_the_same_results(plan, finished, tmp_path):
    summary = compare(plan, tmp_path, backend="loky", jobs=1)
    assert rows_of(tmp_path) == rows_of(finished[0])
    assert without_times(summary) == without_times(finished[1])


def test_dask_gives_the_same_results(plan, finished, tmp_path):
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        compare(plan, tmp_path, backend=f"dask:{cluster.scheduler_address}")
    assert rows_of(tmp_path) == rows_of(finished[0])


def test_a_run_that_was_killed_ends_as_if_it_had_not_been(plan, finished, tmp_path):
    whole = (finished[0] / "trials.jsonl").read_bytes()
    lines = whole.splitlines(keepends=True)
    torn = b"".join(lines[:4]) + lines[4][: len(lines[4]) // 2]
    (tmp_path / "trials.jsonl").write_bytes(torn)
    compare(plan, tmp_path, backend="sequential")
    assert rows_of(tmp_path) == rows_of(finished[0])
    # what was finished was not run again
    assert (tmp_path / "trials.jsonl").read_bytes().startswith(b"".join(lines[:4]))


def test_a_finished_comparison_can_be_narrowed_without_running_anything(plan, finished, tmp_path):
    (tmp_path / "trials.jsonl").write_bytes((finished[0] / "trials.jsonl").read_bytes())
    before = (tmp_path / "trials.jsonl").read_bytes()
    summary = compare(replace(plan, methods=METHODS[:1]), tmp_path, backend="sequential")
    assert (tmp_path / "trials.jsonl").read_bytes() == before
    assert summary["trials"] == len(SOURCES)


def test_rows_of_another_seed_are_not_mixed_in(plan, finished, tmp_path):
    (tmp_path / "trials.jsonl").write_bytes((finished[0] / "trials.jsonl").read_bytes())
    with pytest.raises(OutputError, match="seed 0, not 1"):
        compare(replace(plan, settings=Settings(seed=1)), tmp_path, backend="sequential")


def test_rows_of_another_version_are_not_mixed_in(plan, finished, tmp_path):
    header, *rows = (finished[0] / "trials.jsonl").read_text().splitlines()
    old = [{k: v for k, v in json.loads(row).items() if k != "kept_truth"} for row in rows]
    lines = [json.loads(header) | {"schema": 1}, *old]
    (tmp_path / "trials.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(OutputError, match="another version"):
        compare(plan, tmp_path, backend="sequential")


def test_rows_of_other_options_are_not_mixed_in(plan, finished, tmp_path):
    (tmp_path / "trials.jsonl").write_bytes((finished[0] / "trials.jsonl").read_bytes())
    other = Config(keyframes=KeyframeConfig(window=1))
    with pytest.raises(OutputError, match="other options"):
        compare(replace(plan, settings=Settings(config=other)), tmp_path, backend="sequential")


@pytest.mark.parametrize("line", ["[]", "1", '"text"', "{"])
def test_a_first_line_that_is_none_is_damage(line, tmp_path):
    (tmp_path / "trials.jsonl").write_text(line + "\n")
    with pytest.raises(OutputError, match="line 1 is damaged"):
        Journal(tmp_path / "trials.jsonl", {"seed": 0})


def test_a_damaged_line_is_told(tmp_path):
    with Journal(tmp_path / "trials.jsonl", {"seed": 0}) as journal:
        journal.append({"source": "a", "method": "b", "start": 0})
    with (tmp_path / "trials.jsonl").open("ab") as file:
        file.write(b"not json\n")
    with pytest.raises(OutputError, match="line 3 is damaged"):
        Journal(tmp_path / "trials.jsonl", {"seed": 0})


def test_memory_does_not_hold_the_rows(tmp_path):
    row = {"source": "points:room", "method": "quest", "filler": "x" * 2000}
    with Journal(tmp_path / "trials.jsonl", {}) as journal:
        tracemalloc.start()
        for start in range(2000):
            journal.append(row | {"start": start})
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert sum(1 for _ in journal.rows()) == 2000
    assert grown < 2000 * 500  # a key and a place in the file; the rows are four times that


@pytest.mark.parametrize("name", ["spark", "dask:", ""])
def test_an_unknown_backend_is_told(name, plan, tmp_path):
    with pytest.raises(ConfigError, match="unknown backend"):
        compare(plan, tmp_path, backend=name)


# -- methods that fail -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "cause"),
    [
        ("Raises", "RuntimeError: no such thing as a pose"),
        ("Crashes", "the process died (SIGABRT)"),
        ("Eats", "more than 400 MB of memory"),
        ("Hangs", "no answer within 2 s"),
    ],
)
def test_a_method_that_fails_costs_its_own_trial(method, cause):
    source = describe_sources(SOURCES[:1])[0]
    settings = Settings(memory_limit_mb=400)
    # The first one starts the process and loads what trials need; only then two seconds are long.
    isolated_trial(Trial(source, "stella", 0), settings)
    limit_s = 2.0 if method == "Hangs" else 60.0
    failed = isolated_trial(Trial(source, f"failing_methods:{method}", 0), replace(settings, time_limit_s=limit_s))
    assert (failed["outcome"], failed["reason"]) == ("error", cause)
    assert isolated_trial(Trial(source, "stella", 0), settings)["outcome"] != "error"


# -- what a trial without a map kept and suspects ----------------------------------------------------


def test_an_undecided_plane_is_judged_by_the_maps_that_are_kept():
    """Two maps live on: one as the truth, one turned by 30 degrees; in either order the truth is among them."""
    source = describe_sources(["points:wall?seed=2"])[0]
    opened, judging = open_compared(source.text), judging_of(source.group)
    truth = [opened.groundtruth.world_from_cam[frame] for frame in (0, 8)]
    away = Pose.from_quaternion(np.array([np.cos(0.26), 0.0, np.sin(0.26), 0.0]), np.zeros(3))
    right = SimpleNamespace(
        keyframes=tuple(
            Keyframe(f, 0.1 * f, "", truth[0].inverse() @ pose) for f, pose in zip((0, 8), truth, strict=True)
        )
    )
    wrong = SimpleNamespace(
        keyframes=(
            right.keyframes[0],
            replace(right.keyframes[1], world_from_cam=right.keyframes[1].world_from_cam @ away),
        )
    )

    def kept(*maps, reason="ambiguous_plane"):
        result = Result(None, reason, 12, None, (), {}, hypotheses=maps)
        return trials._kept_truth(result, opened, judging)

    assert kept(right, wrong) is kept(wrong, right) is True
    assert kept(wrong, wrong) is kept() is False
    assert kept(right, wrong, reason="low_parallax") is None


def test_a_wrong_focal_length_that_is_suspected_and_told_is_counted():
    """One check that suspects it is evidence; it takes two that agree until the user is told."""

    def run(*factors):
        evidence = [{"turning_focal_factor": f, "suspected_focal_factor": f} for f in factors]
        attempts = tuple(Attempt((0, k), "pure_rotation", e) for k, e in enumerate(evidence))
        return trials._row(trial, Settings(), Result(None, "pure_rotation", 12, None, attempts, {}), opened, None, ())

    (source,) = describe_sources(["points:rotation?focal_error=0.05"])
    trial, opened = Trial(source, "quest", 0), open_compared(source.text)
    rows = [run(), run(0.96), run(0.95, 0.95, 0.96)]
    assert [row["suspected_focal_factor"] for row in rows] == [None, 0.96, 0.95]
    assert [row["reported_focal_factor"] for row in rows] == [None, None, 0.95]
    rows.append(rows[2] | {"source": "points:rotation"})
    figures = summary_of(TrialTable.of(rows), ["quest"])["parts"]["points_still"]["quest"]
    shares = [round(figures[name][0], 2) for name in ("suspicion_rate", "report_rate", "false_report_rate")]
    assert shares == [0.67, 0.33, 1.0]


def test_the_error_of_the_focal_length_is_read_from_synthetic_sources_only():
    assert focal_error_of("points:rotation?noise_px=1.0&focal_error=-0.02&seed=1") == -0.02
    assert focal_error_of("points:rotation?seed=1") == focal_error_of("folder?focal_error=0.1") == 0.0


# -- sources ---------------------------------------------------------------------------------------


def test_a_fixed_option_changes_nothing_in_the_others():
    free, fixed = drawn_sources("wall", 5, 3), drawn_sources("wall", 5, 3, focal_error=0.5)
    for a, b in zip(free, fixed, strict=True):
        values = [dict(parse_qsl(text.partition("?")[2])) for text in (a, b)]
        assert values[1].pop("focal_error") == "0.5"
        values[0].pop("focal_error")
        assert values[0] == values[1]


def test_the_grid_is_drawn_from_the_seed():
    assert grid_sources(2, seed=1) == grid_sources(2, seed=1) != grid_sources(2, seed=2)
    described = describe_sources(grid_sources(2, seed=1))
    assert len({source.label for source in described}) == len(described) == 18


def test_sources_differ_by_their_seed():
    a, b = (open_compared(f"points:room?seed={seed}").sequence for seed in (1, 2))
    assert not np.array_equal(a.poses, b.poses)


@pytest.mark.parametrize("texts", [["points:room", "points:room"], ["points:attic"], ["points:room?seed=-1"]])
def test_what_cannot_be_compared_on_is_told(texts):
    with pytest.raises(SourceError):
        describe_sources(texts)


def test_a_folder_of_sequences_stands_for_all_below_it(tmp_path):
    from sequences_synth import SynthOptions, make_sequence, write_tum

    for name in ("a", "deep/b"):
        sequence = make_sequence("room", 0, SynthOptions(frames=2, width=64, height=64))
        write_tum(sequence, tmp_path / name)
    assert [source.label for source in describe_sources([str(tmp_path)])] == ["a", "deep/b"]


def test_trials_start_where_half_a_second_is_left():
    (source,) = describe_sources(["points:room?views=40"])
    assert list(source.starts(10)) == [0, 10, 20]
    assert list(replace(source, frames=9).starts(10)) == [0]


def test_video_ends_after_five_seconds_and_photographs_after_the_frames():
    (source,) = describe_sources(["points:room?views=400"])
    assert Settings().frames_limit(source, 0) == 50
    assert Settings().frames_limit(replace(source, fps=1.0), 0) == 150
    assert Settings().frames_limit(source, 390) == 10


def test_known_limits_of_a_truth_are_known_wherever_the_sequence_lies():
    assert judging_of("some/where/V1_01_static").still
    assert not judging_of("redkitchen_a").direction_known
    assert not judging_of("synth:room").still


# -- tracks ----------------------------------------------------------------------------------------


def test_replayed_tracks_lead_to_the_very_same_map(room, room_run, tmp_path):
    frames = tuple(room.frames(0, room_run.result.frames_to_init))
    initializer = Initializer(room.camera)
    for step in find_tracks(GivenFrames(room.camera, frames), "room", tmp_path).steps(0):
        initializer.process_tracks(step.current, step.revised)
    np.testing.assert_array_equal(initializer.map.points, room_run.result.map.points)


def test_frames_that_descriptors_link_are_replayed_with_what_was_known_at_the_time(tmp_path):
    image = texture(5, 700, 1000)
    frames = tuple(window(image, 120 * i, 40 * i, 320, 240, i) for i in range(4))
    camera = Camera("pinhole", 320, 240, 250.0, 250.0, 159.5, 119.5)
    steps = list(find_tracks(GivenFrames(camera, frames), "photographs", tmp_path).steps(0))
    assert any(step.revised for step in steps)
    tracker = Tracker(camera, TrackingConfig())
    for frame, step in zip(frames, steps, strict=True):
        np.testing.assert_array_equal(tracker.track(frame).pixels, step.current.pixels)
        assert [one.frame for one in tracker.revised] == [one.frame for one in step.revised]
        for ours, stored in zip(tracker.revised, step.revised, strict=True):
            np.testing.assert_array_equal(ours.track_ids, stored.track_ids)


# -- the command, recordings, examples -------------------------------------------------------------

DATA_SET = "python:slam_init.examples.add_a_data_set:Poster"


def test_the_command_writes_tables_a_page_and_recordings_of_a_data_set_and_a_method_of_ones_own(tmp_path, capsys):
    methods = ["quest-two-view", "slam_init.examples.add_a_method:MedianParallax"]
    options = ["--every", "30", "--limit-frames", "12", "--backend", "sequential", "--recordings"]
    assert main(["compare", DATA_SET, *options, "--methods", ",".join(methods), "--out", str(tmp_path)]) == 0
    assert "images, moving camera" in capsys.readouterr().out
    rows = rows_of(tmp_path)
    assert [(row["source"], row["method"], row["outcome"]) for row in rows] == [
        (DATA_SET, method, "correct") for method in methods
    ]
    names = [path.name for path in sorted(tmp_path.rglob("*.rrd"))]
    assert names == ["quest-two-view.rrd", "side-by-side.rrd", "slam_init.examples.add_a_method-MedianParallax.rrd"]
    assert not list(tmp_path.rglob("*.npz"))  # what trials kept for the recording side by side is gone


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["points:room", "--methods", "magic"],
        ["points:room", "--methods", "stella,stella"],
        ["points:room", "--backend", "spark"],
        ["points:room", "--jobs", "0"],
        ["nowhere"],
        ["python:nowhere:nothing"],
    ],
)
def test_what_is_wrong_with_the_command_is_told_in_one_line(arguments, tmp_path, capsys):
    assert main(["compare", *arguments, "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("slam-init: error: ")
    assert message.count("\n") == 1


def test_the_recording_side_by_side_is_sound_and_the_same_for_the_same_trials(tmp_path):
    found = []
    for name in ("a", "b"):
        plan = Plan(tuple(describe_sources(SOURCES[:1])), METHODS[:2])
        compare(plan, tmp_path / name, backend="sequential", recordings=True)
        found.append(next((tmp_path / name).rglob("side-by-side.rrd")))
    assert rerun_tool("verify", found[0]).returncode == 0
    assert rerun_tool("compare", "--unordered", *found).returncode == 0
    shown = set(entities(found[0]))
    for entity in ("/frame/image", "/method-00/map/points", "/method-00/verdict", "/method-01/verdict"):
        assert entity in shown
