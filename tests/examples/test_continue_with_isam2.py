"""The example continues from the graph of a map with ISAM2."""

import importlib

import continue_with_isam2 as continue_with_isam2_module
import pytest
from continue_with_isam2 import continue_with_isam2, main, position_errors

from slam_init.bundle.graph import pose_key
from slam_init.bundle.reprojection import calibration_key

pytestmark = pytest.mark.process

#: After the map.
FRAMES = 8


def test_isam2_continues_from_the_graph_of_the_map(room_fed):
    map_ = room_fed.result.map
    frames = room_fed.following[:FRAMES]
    poses = continue_with_isam2(map_, room_fed.tracker, frames)
    assert [keyframe.frame for keyframe in poses] == [frame.index for frame in frames]
    assert position_errors([*map_.keyframes, *poses], room_fed.source.groundtruth).max() < 0.02
    assert not map_.values.exists(pose_key(poses[0].frame))  # the map itself is not changed


@pytest.mark.parametrize("example", ["continue_with_isam2", "continue_with_colmap", "own_tracks"])
def test_an_example_prints_the_reason_of_a_refusal_or_an_error(example, capsys):
    main = importlib.import_module(example).main
    assert main(["synth:static?frames=4&width=320&height=240"]) == 3
    assert "static_camera" in capsys.readouterr().out
    assert main(["synth:nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_example_runs_from_frames_to_poses(room, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr(continue_with_isam2_module, "open_source", lambda name: opened.append(name) or room)
    assert main([]) == 0
    assert opened == ["synth:room"]
    out = capsys.readouterr().out
    assert "15 of the next 15 frames located" in out
    assert "ground truth" in out


def test_isam2_continues_with_the_calibration_as_a_variable(room_refined):
    map_ = room_refined.result.map
    assert map_.values.exists(calibration_key())
    frames = room_refined.following[:FRAMES]
    poses = continue_with_isam2(map_, room_refined.tracker, frames)
    assert [keyframe.frame for keyframe in poses] == [frame.index for frame in frames]
    # Principal point and k1 are variables too, and this lens is exact: 0.02 where they are held.
    assert position_errors([*map_.keyframes, *poses], room_refined.source.groundtruth).max() < 0.06
