"""Initializations are counted by the classes of the comparison."""

from comparisons import table_cells

from tests.benchmarks import initialization
from tests.benchmarks.image_pairs import find_sequences
from tests.benchmarks.initialization import count_table, main, run_all


def test_a_sequence_is_found_if_it_has_a_camera_a_ground_truth_and_a_single_motion(tmp_path):
    for name in ("b/two", "a/one", "planar/opencv_chessboard", "pairs/no_truth"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "camera.yaml").touch()
        if name != "pairs/no_truth":
            (tmp_path / name / "groundtruth.txt").touch()
    assert find_sequences(tmp_path) == ["a/one", "b/two"]


def test_classes_reasons_and_frames_of_a_group_are_counted():
    size = "width=320&height=240"
    still, room = run_all([f"synth:static?frames=3&{size}", f"synth:room?frames=20&{size}"], 1)
    assert (still.outcome, still.reason) == ("none", "static_camera")
    assert room.outcome == "correct"
    *scenes, total = table_cells(count_table([still, room, still]))
    frames = str(room.frames_to_accept)
    assert scenes[0] == ["static", "2", "0", "0", "0", "2", "2 static_camera", "-"]
    assert scenes[1][:3] + scenes[1][-2:] == ["room", "1", "1", "-", frames]
    assert total[:3] + total[-2:] == ["all", "3", "1", "2 static_camera", frames]


def test_the_program_writes_what_it_prints(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(initialization, "run_all", lambda texts, jobs: [])
    options = ["--only", "synthetic", "--scenes", "room", "--seeds", "2", "--out", str(tmp_path / "t.md")]
    assert main(options) == 0
    assert capsys.readouterr().out == (tmp_path / "t.md").read_text()
