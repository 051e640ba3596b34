"""Initializations are classified and counted; the program prints the counts of its runs."""

from __future__ import annotations

import pytest

from sequences_synth import SCENES
from slam_init import datasets
from tests.benchmarks import initialization
from tests.benchmarks.initialization import (
    NO_TRANSLATION,
    Outcome,
    Task,
    classify,
    count,
    delay_text,
    find_sequences,
    from_first_motion,
    real_tasks,
    run_all,
)


def outcome(rotation_deg, direction_deg, label="synth:room", frames=10):
    return Outcome(Task(label, label), None, frames, 500, rotation_deg, direction_deg, 1.0, 0.1)


@pytest.mark.parametrize(
    ("rotation_deg", "direction_deg", "expected_class"),
    [
        (0.99, 4.99, "strict"),
        (1.0, 4.0, "correct"),
        (0.1, 5.0, "correct"),
        (4.99, 14.99, "correct"),
        (5.0, 1.0, "false"),
        (0.1, 15.0, "false"),
        (0.1, None, "false"),
        (None, None, "false"),
        (float("nan"), 1.0, "false"),
    ],
)
def test_a_map_is_classified_by_both_of_its_errors(rotation_deg, direction_deg, expected_class):
    assert classify(outcome(rotation_deg, direction_deg)) == expected_class


@pytest.mark.parametrize("label", ["synth:rotation", "synth:static", "euroc/V1_01_static"])
def test_every_map_of_a_camera_that_never_translates_is_false(label):
    assert classify(outcome(0.0, 0.0, label)) == "false"
    assert classify(Outcome(Task(label, label), "static_camera")) == "none"


@pytest.mark.parametrize("label", ["7scenes/redkitchen_a", "tum_rgbd/fr1_desk_9frames"])
def test_only_the_rotation_counts_if_the_ground_truth_does_not_resolve_the_direction(label):
    assert classify(outcome(0.5, 40.0, label)) == "strict"
    assert classify(outcome(2.0, 0.0, label)) == "correct"
    assert classify(outcome(6.0, 0.0, label)) == "false"


def test_the_scenes_without_translation_exist():
    assert {f"synth:{name}" for name in SCENES} >= {n for n in NO_TRANSLATION if n.startswith("synth:")}


def test_classes_reasons_and_frames_of_a_group_are_counted():
    none = [Outcome(Task("s", "s"), reason) for reason in ("low_parallax", "ambiguous_plane", "low_parallax")]
    found = [outcome(0.1, 1.0, frames=8), outcome(2.0, 9.0, frames=11), outcome(9.0, 1.0, frames=50)]
    assert count(none + found) == ["2", "1", "1", "3", "2 low_parallax, 1 ambiguous_plane", "11"]
    assert count(none)[-1] == "-"


def test_a_sequence_is_found_if_it_has_a_camera_a_ground_truth_and_a_single_motion(tmp_path):
    for name in ("b/two", "a/one", "planar/opencv_chessboard", "pairs/no_truth"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "camera.yaml").touch()
        if name != "pairs/no_truth":
            (tmp_path / name / "groundtruth.txt").touch()
    assert find_sequences(tmp_path) == find_sequences(str(tmp_path)) == ["a/one", "b/two"]


def test_outcomes_are_in_the_order_of_the_tasks_for_any_number_of_processes():
    tasks = [Task("synth:static", "synth:static?frames=3&width=320&height=240", seed) for seed in (1, 0)]
    outcomes = run_all(tasks)
    assert [o.task for o in outcomes] == tasks
    assert {(classify(o), o.reason) for o in outcomes} == {("none", "static_camera")}
    assert run_all(tasks, jobs=2) == outcomes


def test_the_program_prints_and_writes_the_counts_of_its_runs(monkeypatch, tmp_path, capsys):
    given = [outcome(0.1, 1.0), outcome(0.1, 20.0)]
    monkeypatch.setattr(initialization, "run_all", lambda tasks, jobs: given if len(tasks) == 2 else [])
    options = ["--only", "synthetic", "--scenes", "room", "--seeds", "2", "--out", str(tmp_path / "t.md")]
    assert initialization.main(options) == 0
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "t.md").read_text()
    cells = [cell.strip() for cell in shown.splitlines()[-1].strip("|").split("|")]
    assert cells == ["room", "2", "1", "1", "1", "0", "-", "10"]


def test_runs_start_at_every_kth_frame_with_enough_frames_left(tmp_path, monkeypatch):
    for name in ("camera.yaml", "groundtruth.txt"):
        (tmp_path / "long").mkdir(exist_ok=True)
        (tmp_path / "long" / name).touch()
    monkeypatch.setattr(datasets, "open_source", lambda _: range(40))
    tasks = real_tasks(tmp_path, every=10)
    assert [task.start for task in tasks] == [0, 10, 20]
    assert [task.start for task in real_tasks(tmp_path, every=None)] == [0]


def test_the_delay_is_relative_to_an_initializer_that_starts_at_the_first_translation():
    whole = Task("synth:rotate-then-move", "synth:rotate-then-move", 3)
    late = from_first_motion(whole)
    assert (late.source, late.seed) == (whole.source, whole.seed)
    assert 39 <= late.start <= 50

    def took(task, frames, error=0.1):
        reason = None if frames else "low_parallax"
        return Outcome(task, reason, frames_to_init=frames, rotation_error_deg=error, direction_error_deg=error)

    text = delay_text([took(whole, 60), took(whole, 63)], [took(late, 60 - late.start)] * 2)
    assert "1.5 frames later (median; 0 to 3; 2 of 2 runs)" in text
    for without in (took(whole, None), took(whole, 12, error=90.0)):
        assert "no delay is measured" in delay_text([without], [took(late, 20)])
    with pytest.raises(ValueError, match="never moves"):
        from_first_motion(Task("synth:static", "synth:static?frames=3"))


@pytest.mark.parametrize("options", [["--scenes", "moon"], ["--seeds", "0"], ["--every", "x"], ["--jobs", "-1"]])
def test_wrong_options_are_refused(options, capsys):
    with pytest.raises(SystemExit) as error:
        initialization.main(options)
    assert error.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_the_table_of_real_sequences_needs_data(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert initialization.main(["--only", "real"]) == 2
    assert "SLAM_INIT_DATA" in capsys.readouterr().err
