"""``slam-init join`` and ``locate``: saved maps are joined, or not; a file without a place is bad input."""

import json

import numpy as np
import pytest
from make_map import make_map
from make_place import make_place, moved

import slam_init.cli.locate
from quest.geometry.quaternion import rotation_from_vector
from slam_init import Finder, Similarity, SourceError, load_place
from slam_init.cli import main
from slam_init.mapping.finding import Found
from slam_init.output.handover import handover_bytes
from slam_init.types.initial_map import Keyframe
from slam_init.types.place import Appearance
from slam_init.types.pose import Pose

ROOM = "synth:room?frames=4&width=160&height=120"

MOTION = Similarity(0.4, rotation_from_vector(np.array([0.0, 0.5, 0.0])), np.array([1.0, 0.0, 0.0]))


def written(path, place):
    map_ = make_map()
    none = Appearance(np.zeros((len(map_.points), 32), np.uint8), np.zeros(len(map_.points), bool), place)
    path.write_bytes(handover_bytes(map_, (), none))
    return str(path)


def test_a_saved_place_is_read_as_it_was(tmp_path):
    place = make_place()
    found = load_place(written(tmp_path / "handover.npz", place))
    np.testing.assert_allclose(found.points, place.points)
    np.testing.assert_allclose(found.observation_bearings, place.observation_bearings)
    assert np.sum(found.descriptors * place.descriptors, axis=1).min() > 0.999
    assert [view.frame for view in found.views] == [0, 1, 2, 3] and found.noise_rad == place.noise_rad


def test_saved_maps_are_joined_or_not(tmp_path, capsys):
    place = make_place()
    first, second = written(tmp_path / "a.npz", place), written(tmp_path / "b.npz", moved(place, MOTION))
    other = written(tmp_path / "c.npz", make_place(1))
    assert main(["join", first, second, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["first_from_second"]["s"] == pytest.approx(2.5, rel=1e-5)
    assert main(["join", first, other]) == 3
    assert "not joined: no common place" in capsys.readouterr().out


def test_a_map_without_a_place_is_bad_input(tmp_path, capsys):
    path = tmp_path / "handover.npz"
    path.write_bytes(handover_bytes(make_map()))
    with pytest.raises(SourceError, match="no place"):
        load_place(tmp_path)
    np.savez(path, points=np.zeros((3, 3)))
    assert main(["join", str(path), str(path)]) == 2
    assert "has no place_frames" in capsys.readouterr().err
    arrays = dict(np.load(written(path, make_place())))
    np.savez(path, **(arrays | {"place_observation_points": arrays["place_observation_points"] + 1}))
    with pytest.raises(SourceError, match="do not fit together"):
        load_place(path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match=r"empty: holds no handover\.npz"):
        load_place(tmp_path / "empty")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            lambda a: {name: a[name][:0] for name in a if "place_observation" in name or "bearings" in name},
            "no view sees",
        ),
        (lambda _: {"version": np.array(2)}, "is no slam-init-handover of version 1"),
        (lambda a: {"place_noise": np.array(1e300)}, "place_noise is 1e"),
        (lambda a: {"place_noise": np.array(-1.0)}, "place_noise is -1"),
        (lambda a: {"place_points": a["place_points"] * 1e200}, "reaches to"),
        (lambda a: {"place_frames": a["place_frames"] + 0.5}, "no ascending indices"),
        (lambda a: {"place_frames": a["place_frames"][::-1]}, "no ascending indices"),
        (lambda a: {"place_frames": a["place_frames"] - 9}, "no ascending indices"),
        (lambda a: {"place_frames": a["place_frames"] * 10**18}, "no ascending indices"),
    ],
)
def test_a_place_without_a_meaning_is_bad_input(changed, said, tmp_path):
    path = tmp_path / "handover.npz"
    arrays = dict(np.load(written(path, make_place())))
    np.savez(path, **(arrays | changed(arrays)))
    with pytest.raises(SourceError, match=said):
        load_place(path)


def test_the_frames_of_another_world_are_not_located(tmp_path, capsys):
    saved = written(tmp_path / "a.npz", make_place())
    assert main(["locate", saved, "synth:room?frames=2&width=160&height=120"]) == 3
    assert capsys.readouterr().out.endswith("# 0 of 2 frames found, 120 points\n")


@pytest.fixture
def all_found(monkeypatch):
    """Finds each frame of a source, but is interrupted at the third one."""

    def locate(self, frame):
        if frame.index == 2:
            raise KeyboardInterrupt
        return Found(Keyframe(frame.index, frame.timestamp_s, frame.name, Pose.identity()), 0.0, 9, 9)

    monkeypatch.setattr(Finder, "locate", locate)


def test_an_interrupt_leaves_the_poses_so_far(all_found, tmp_path, capsys):
    saved = written(tmp_path / "a.npz", make_place())
    assert main(["locate", saved, ROOM]) == 130
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows[1:]] == ["0.000000000", "0.033333333"] and rows[0].startswith("# timestamp")


def test_a_reader_that_has_enough_ends_the_search(all_found, tmp_path, monkeypatch):
    saved, said = written(tmp_path / "a.npz", make_place()), []
    monkeypatch.setattr(slam_init.cli.locate, "tell", lambda text: bool(said.append(text)))
    assert main(["locate", saved, ROOM]) == 0
    assert len(said) == 3 and said[-1].startswith("# 1 of 1 frames")
