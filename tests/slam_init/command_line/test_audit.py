"""``slam-init audit``: the same map in several formats, and what is no map."""

import json

import numpy as np
import pycolmap
import pytest
from make_map import make_map

from slam_init import Pose, open_source, write_colmap
from slam_init.cli import main
from slam_init.datasets.posed_images import with_axes
from slam_init.output.handover import handover_bytes
from slam_init.output.results import tum_text
from slam_init.types.initial_map import Keyframe

pytestmark = pytest.mark.slow

POINTS = 200
ROOM = "synth:room?frames=10&width=320&height=240&slow_start=1"


@pytest.fixture
def map_():
    return make_map(points=POINTS)


def message(words, capsys):
    code = main(["audit", *words, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_same_map_has_the_same_risk_in_all_formats(map_, tmp_path, capsys):
    write_colmap(map_, tmp_path / "model")
    (tmp_path / "binary").mkdir()
    pycolmap.Reconstruction(tmp_path / "model").write_binary(tmp_path / "binary")
    (tmp_path / "handover.npz").write_bytes(handover_bytes(map_))
    map_.save(tmp_path / "run")
    names = ("model", "binary", "handover.npz", ".", "run/graph.txt")
    found = [message([str(tmp_path / name)], capsys) for name in names]
    assert [code for code, _ in found] == len(names) * [0]
    risks = [one["risk"] for _, one in found]
    assert risks == pytest.approx(len(names) * [risks[0]], rel=1e-3)
    assert found[0][1]["verdict"] == "sound" and found[0][1]["better"] is None


@pytest.mark.slow
@pytest.mark.parametrize(("moved", "code"), [(False, 0), (True, 4)])
def test_a_trajectory_is_audited_by_the_images(moved, code, tmp_path, capsys):
    truth = open_source(ROOM).groundtruth
    stamped = list(zip(truth.timestamps_s.tolist(), truth.world_from_cam, strict=True))
    if moved:  # backwards in time: the rotations and the ways of other frames
        stamped = [(time_s, pose) for (time_s, _), (_, pose) in zip(stamped, reversed(stamped), strict=True)]
    keyframes = [Keyframe(k, time_s, str(k), pose) for k, (time_s, pose) in enumerate(stamped)]
    (tmp_path / "poses.txt").write_text(tum_text(keyframes))
    assert main(["audit", str(tmp_path / "poses.txt"), "--images", ROOM]) == code
    assert ("sound" if code == 0 else "what decides") in capsys.readouterr().out


@pytest.mark.slow
def test_a_trajectory_in_another_convention_is_the_same_map(tmp_path, capsys):
    """A note says which convention it is. Other programs state theirs: there it is an advice."""
    truth = open_source(ROOM).groundtruth
    others = {
        "cam_from_world": Pose.inverse,
        "quaternions with w first": lambda pose: Pose.from_quaternion(np.roll(pose.q_wxyz, 1), pose.t),
        "camera axes right, up, backward": lambda pose: with_axes(pose, "right, up, backward"),
    }
    for name, other in others.items():
        poses = [other(pose) for pose in truth.world_from_cam]
        keyframes = [Keyframe(k, truth.timestamps_s[k], str(k), pose) for k, pose in enumerate(poses)]
        (tmp_path / "poses.txt").write_text(tum_text(keyframes))
        code, found = message([str(tmp_path / "poses.txt"), "--images", ROOM], capsys)
        assert (code, found["verdict"]) == (0, "sound")
        (note,) = found["notes"]
        assert f"read as {name}," in note


def no_listed_image(folder):
    (folder / "transforms.json").write_text(
        json.dumps({"fl_x": 300, "w": 320, "h": 240, "frames": 2 * [{"file_path": "a.png", "transform_matrix": EYE}]})
    )
    return "transforms.json"


EYE = np.eye(4).tolist()


def broken_npz(folder):
    (folder / "map").write_bytes(b"")
    np.savez(folder / "cut.npz", format="slam-init-handover")
    return "cut.npz"


def no_images(folder):
    (folder / "poses.txt").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    return "poses.txt"


def changed(**arrays):
    def make(folder):
        (folder / "handover.npz").write_bytes(handover_bytes(make_map(points=POINTS)))
        known = dict(np.load(folder / "handover.npz"))
        np.savez(folder / "handover.npz", **(known | {name: change(known[name]) for name, change in arrays.items()}))
        return "handover.npz"

    return make


def too_few_points(folder):
    write_colmap(make_map(points=8), folder / "few")
    return "few"


NO_MAPS = [
    (lambda _: "absent", "no such map"),
    (lambda folder: str(folder), "holds no map"),
    (broken_npz, "has no array"),
    (no_images, "--images"),
    (no_listed_image, "--images"),
    (too_few_points, "few: no two frames with a pose share"),
    (changed(keyframe_frames=np.zeros_like), "keyframe_frames has a frame twice"),
    (changed(observation_keyframes=lambda keyframes: keyframes[:0]), "its arrays do not fit together"),
    (changed(observation_points=lambda points: points + 10**6), "its arrays do not fit together"),
    (changed(observation_pixels=lambda pixels: pixels * 1e30), "handover.npz: no two frames"),
]


def test_what_is_no_map_is_reported_in_one_line(tmp_path, monkeypatch, capsys):
    for number, (make, said) in enumerate(NO_MAPS):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        assert main(["audit", make(folder)]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1


def test_images_of_another_scene_are_distinguished_from_a_wrong_map(room_run, capsys):
    """The map is right; the wall moves the other way. The images of the map itself are never accused."""
    code, found = message([str(room_run.out), "--images", "synth:wall?frames=12"], capsys)
    assert (code, found["verdict"]) == (4, "wrong")
    assert "they do not belong together: give the images of the map" in found["advice"]
