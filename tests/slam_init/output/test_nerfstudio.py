"""Laws of transforms.json: cameras in the axes of OpenGL that see what ours see."""

import json

import numpy as np
import pytest
from make_map import CAMERAS, make_map

from slam_init.output.scene import transforms_text


def test_in_the_axes_of_opengl_the_scene_lies_at_negative_z_and_up_is_positive():
    map_ = make_map()
    (frame, *_) = json.loads(transforms_text(map_))["frames"]
    matrix = np.linalg.inv(frame["transform_matrix"])
    seen = map_.points @ matrix[:3, :3].T + matrix[:3, 3]
    ours = map_.keyframes[0].world_from_cam.inverse().apply(map_.points)
    np.testing.assert_allclose(seen, ours * [1, -1, -1], atol=1e-12)
    assert (seen[:, 2] < 0).all()


@pytest.mark.parametrize("model", CAMERAS)
def test_the_intrinsics_have_nerfstudios_names_and_pixel_centres(model):
    content, camera = json.loads(transforms_text(make_map(model))), CAMERAS[model]
    assert content["camera_model"] == ("OPENCV_FISHEYE" if model == "fisheye" else "OPENCV")
    # instant-ngp reads no camera_model.
    assert content.get("is_fisheye", False) == (model == "fisheye")
    assert (content["fl_x"], content["fl_y"], content["w"], content["h"]) == (camera.fx, camera.fy, 640, 480)
    assert (content["cx"], content["cy"]) == (camera.cx + 0.5, camera.cy + 0.5)
    names = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    assert [content.get(name, 0.0) for name in names[: len(camera.distortion)]] == list(camera.distortion)
    assert content["ply_file_path"] == "map.ply"
