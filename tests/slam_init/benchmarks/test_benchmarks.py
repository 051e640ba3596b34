"""The figures: what counts as correct, which sequences are run, and that the programs print what they measured."""

from __future__ import annotations

import platform

import pytest

from sequences_synth import SCENES
from slam_init import datasets
from slam_init.benchmarks import initialization, timing
from slam_init.benchmarks.initialization import Outcome, Task, count, find_sequences, judge, run_all
from slam_init.output.tables import markdown_table, number


def outcome(rotation_deg, direction_deg, label="synth:room", frames=10):
    return Outcome(Task(label, label), None, frames, 500, rotation_deg, direction_deg, 1.0, 0.1)


@pytest.mark.parametrize(
    ("rotation_deg", "direction_deg", "verdict"),
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
def test_a_map_is_judged_by_both_of_its_errors(rotation_deg, direction_deg, verdict):
    assert judge(outcome(rotation_deg, direction_deg)) == verdict


@pytest.mark.parametrize("label", ["synth:rotation", "synth:static", "euroc/V1_01_static"])
def test_every_map_of_a_camera_that_never_translates_is_false(label):
    assert judge(outcome(0.0, 0.0, label)) == "false"
    assert judge(Outcome(Task(label, label), "static_camera")) == "none"


@pytest.mark.parametrize("label", ["7scenes/redkitchen_a", "tum_rgbd/fr1_desk_9frames"])
def test_where_the_truth_knows_no_direction_the_rotation_decides(label):
    assert judge(outcome(0.5, 40.0, label)) == "strict"
    assert judge(outcome(2.0, 0.0, label)) == "correct"
    assert judge(outcome(6.0, 0.0, label)) == "false"


def test_the_still_scenes_are_named_as_the_scenes_are():
    assert {f"synth:{name}" for name in SCENES} >= {n for n in initialization._STILL if n.startswith("synth:")}


def test_a_group_is_counted():
    none = [Outcome(Task("s", "s"), reason) for reason in ("low_parallax", "ambiguous_plane", "low_parallax")]
    found = [outcome(0.1, 1.0, frames=8), outcome(2.0, 9.0, frames=11), outcome(9.0, 1.0, frames=50)]
    assert count(none + found) == ["2", "1", "1", "3", "2 low_parallax, 1 ambiguous_plane", "11"]
    assert count(none)[-1] == "-"


def test_sequences_have_a_camera_and_a_truth_and_one_motion(tmp_path):
    for name in ("b/two", "a/one", "planar/opencv_chessboard", "pairs/no_truth"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "camera.yaml").touch()
        if name != "pairs/no_truth":
            (tmp_path / name / "groundtruth.txt").touch()
    assert find_sequences(tmp_path) == ["a/one", "b/two"]


def test_a_static_world_is_none_and_the_order_is_that_of_the_tasks_with_any_number_of_processes():
    tasks = [Task("synth:static", "synth:static?frames=5", seed) for seed in (1, 0)]
    outcomes = run_all(tasks)
    assert [o.task for o in outcomes] == tasks
    assert {(judge(o), o.reason) for o in outcomes} == {("none", "static_camera")}
    assert run_all(tasks, jobs=2) == outcomes


def test_the_program_prints_what_the_runs_gave(monkeypatch, tmp_path, capsys):
    given = [outcome(0.1, 1.0), outcome(0.1, 20.0)]
    monkeypatch.setattr(initialization, "run_all", lambda tasks, jobs: given if len(tasks) == 2 else [])
    options = ["--only", "synthetic", "--scenes", "room", "--seeds", "2", "--out", str(tmp_path / "t.md")]
    assert initialization.main(options) == 0
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "t.md").read_text()
    cells = [cell.strip() for cell in shown.splitlines()[-1].strip("|").split("|")]
    assert cells == ["room", "2", "1", "1", "1", "0", "-", "10"]


def test_every_kth_frame_is_a_start_that_leaves_frames_to_run_on(tmp_path, monkeypatch):
    for name in ("camera.yaml", "groundtruth.txt"):
        (tmp_path / "long").mkdir(exist_ok=True)
        (tmp_path / "long" / name).touch()
    monkeypatch.setattr(datasets, "open_source", lambda _: range(40))
    tasks = initialization._real_tasks(tmp_path, every=10)
    assert [task.start for task in tasks] == [0, 10, 20]
    assert [task.start for task in initialization._real_tasks(tmp_path, every=None)] == [0]


def test_the_delay_is_counted_from_an_initializer_that_begins_with_the_motion():
    whole = Task("synth:rotate-then-move", "synth:rotate-then-move", 3)
    late = initialization.from_first_motion(whole)
    assert (late.source, late.seed) == (whole.source, whole.seed)
    assert 39 <= late.start <= 50

    def took(task, frames, error=0.1):
        reason = None if frames else "low_parallax"
        return Outcome(task, reason, frames_to_init=frames, rotation_error_deg=error, direction_error_deg=error)

    text = initialization.delay_text([took(whole, 60), took(whole, 63)], [took(late, 60 - late.start)] * 2)
    assert "1.5 frames later (median; 0 to 3; 2 of 2 runs)" in text
    for without in (took(whole, None), took(whole, 12, error=90.0)):
        assert "no delay" in initialization.delay_text([without], [took(late, 20)])
    with pytest.raises(ValueError, match="never moves"):
        initialization.from_first_motion(Task("synth:static", "synth:static?frames=5"))


@pytest.mark.parametrize("options", [["--scenes", "moon"], ["--seeds", "0"], ["--every", "x"], ["--jobs", "-1"]])
def test_bad_options_are_refused(options, capsys):
    with pytest.raises(SystemExit) as error:
        initialization.main(options)
    assert error.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_without_data_the_real_table_cannot_be_made(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert initialization.main(["--only", "real"]) == 2
    assert "SLAM_INIT_DATA" in capsys.readouterr().err


def test_all_frames_of_a_static_world_wait():
    measured = timing.measure("static", [("synth:static?frames=4", 0), ("synth:static?frames=4", 1)])
    assert (len(measured.waiting_ms), len(measured.accepted_ms)) == (8, 0)
    assert measured.stages_ms["track"]["calls"] == 8
    table = timing._tables([measured])
    assert "static" in table
    assert "(8)" in table


def test_the_machine_is_described_and_not_named():
    assert platform.python_version() in timing.machine()
    assert not platform.node() or platform.node() not in timing.machine()


def test_a_table_has_cells_of_one_width():
    lines = markdown_table(["a", "long"], [["much longer", number(1.234)], ["b", number(None)]]).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1].endswith("---: |")
    assert "1.23 |" in lines[2]
