"""The handover: documented arrays that are the map, equal for equal maps, read without pickles."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS, make_map
from read_handover import main, read_handover

from slam_init.output import handover
from slam_init.output.handover import handover_arrays, handover_bytes
from slam_init.types.camera import Camera
from slam_init.types.scale import Scale, ScaleOrigin


def loaded(*arguments):
    return dict(np.load(io.BytesIO(handover_bytes(*arguments)), allow_pickle=False))


@pytest.mark.parametrize("model", CAMERAS)
def test_the_arrays_project_to_the_observations(model):
    map_ = make_map(model, noise_px=0.0)
    data = loaded(map_)
    fx, fy, cx, cy, *distortion = data["camera_parameters"]
    camera = Camera(str(data["camera_model"]), *map(int, data["camera_size"]), fx, fy, cx, cy, tuple(distortion))
    cam_from_world = np.linalg.inv(data["keyframe_poses"])[data["observation_keyframes"]]
    points = data["points"][data["observation_points"]]
    in_camera = np.einsum("nij,nj->ni", cam_from_world[:, :3, :3], points) + cam_from_world[:, :3, 3]
    np.testing.assert_allclose(camera.project(in_camera), data["observation_pixels"], atol=1e-6)


def test_all_arrays_and_no_others_are_documented():
    documented = re.findall(r"^``(\w+)`` ", handover.__doc__, re.MULTILINE)
    assert documented == list(handover_arrays(make_map()))


def test_the_same_map_gives_the_same_bytes_and_the_unit_is_reported():
    map_ = make_map()
    assert handover_bytes(map_) == handover_bytes(make_map())
    assert str(loaded(map_)["unit"]) == "median depth"
    metric = loaded(replace(map_, scale=Scale(ScaleOrigin.HEIGHT, 2.0, 0.1)))
    assert (str(metric["unit"]), float(metric["metres_per_unit"]), float(metric["scale_sigma"])) == ("metre", 2.0, 0.1)


def test_the_reader_of_the_example_gives_what_each_keyframe_sees(tmp_path, capsys):
    map_ = make_map()
    path = tmp_path / "handover.npz"
    path.write_bytes(handover_bytes(map_))
    keyframes = read_handover(str(path))
    assert [keyframe["id"] for keyframe in keyframes] == [10, 17, 24, 31]
    rows = map_.observation_keyframes == 2
    np.testing.assert_array_equal(keyframes[2]["pixels"], map_.observation_pixels[rows])
    np.testing.assert_array_equal(keyframes[2]["points"], map_.points[map_.observation_landmarks[rows]])
    assert main([str(path)]) == 0
    assert capsys.readouterr().out.count("keyframe") == 4


def test_risk_depths_covariances_and_the_tracks_without_a_point_are_handed_over():
    map_ = replace(make_map(), model_risk=0.002)
    data = loaded(map_)
    assert (float(data["risk"]), float(data["depth_sigma"])) == (map_.risk, np.median(data["point_depth_sigmas"]))
    assert data["point_covariances"].shape == (len(map_.points), 3, 3)
    np.testing.assert_array_equal(data["point_depth_sigmas"], map_.depth_sigmas)
    assert data["unit_sigma"] == map_.scale_uncertainty.own
    np.testing.assert_array_equal(data["unit_by_lens"], map_.scale_uncertainty.by_lens)
    assert not np.isin(data["track_ids"], data["point_ids"]).any()
    rays = map_.camera.bearings(data["track_pixels"])
    np.testing.assert_allclose(data["track_bearings"], rays, atol=1e-12)
    assert np.isnan(loaded(make_map())["risk"])


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no archive"])
def test_the_reader_refuses_what_is_no_handover_in_one_line(tmp_path, capsys, content):
    path = tmp_path / "handover.npz"
    path.write_bytes(content)
    assert main([str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main([str(tmp_path / "nothing.npz")]) == 2
    np.savez(path, points=np.zeros((3, 3)))
    assert main([str(path)]) == 2
