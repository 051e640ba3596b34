"""``slam-init join`` and ``locate``: saved maps are joined, or not; a file without a place is bad input."""

import json

import numpy as np
import pytest
from make_map import make_map
from make_place import make_place, moved

from quest.geometry.quaternion import rotation_from_vector
from slam_init import Similarity, SourceError, load_place
from slam_init.cli import main
from slam_init.output.handover import handover_bytes
from slam_init.types.place import Appearance

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


def test_the_frames_of_another_world_are_not_located(tmp_path, capsys):
    saved = written(tmp_path / "a.npz", make_place())
    assert main(["locate", saved, "synth:room?frames=2&width=160&height=120"]) == 3
    assert capsys.readouterr().out.startswith("# 0 of 2 frames found, 120 points")
