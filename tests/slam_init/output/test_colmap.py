"""COLMAP reads the model, and computes the same reprojection errors."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from make_map import CAMERAS, make_map

from slam_init.output.colmap import colmap_model, numbers_text
from slam_init.output.names import COLMAP_FILES


def read_by_colmap(folder, map_):
    """The model of a map, written and read back by COLMAP."""
    for name, text in zip(COLMAP_FILES, colmap_model(map_), strict=True):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return pycolmap.Reconstruction(folder / "colmap")


@pytest.mark.parametrize("model", CAMERAS)
def test_colmap_reads_the_model_and_computes_the_same_reprojection_errors(tmp_path, model):
    map_, camera = make_map(model), CAMERAS[model]
    read = read_by_colmap(tmp_path, map_)
    expected = {
        "pinhole": "PINHOLE",
        "radtan": "OPENCV",
        "radtan5": "FULL_OPENCV",
        "fisheye": "OPENCV_FISHEYE",
    }
    assert read.cameras[1].model.name == expected[model]
    assert [read.images[k + 1].name for k in range(4)] == [k.name for k in map_.keyframes]
    assert read.num_points3D() == len(map_.points)
    assert read.compute_num_observations() == len(map_.observation_pixels)

    written_px = {i: point.error for i, point in read.points3D.items()}
    read.update_point_3d_errors()
    for i, point in read.points3D.items():
        assert point.error == pytest.approx(written_px[i], abs=1e-6)
    errors_px = []
    for k, i, pixel in zip(
        map_.observation_keyframes, map_.observation_landmarks, map_.observation_pixels, strict=True
    ):
        cam_from_world = map_.keyframes[k].world_from_cam.inverse()
        errors_px.append(np.linalg.norm(camera.project(cam_from_world.apply(map_.points[i]))[0] - pixel))
    assert np.sqrt(np.mean(np.square(errors_px))) == pytest.approx(map_.reprojection_rmse_px)
    by_point = [np.mean(np.array(errors_px)[map_.observation_landmarks == i]) for i in range(len(map_.points))]
    assert read.compute_mean_reprojection_error() == pytest.approx(np.mean(by_point), abs=1e-6)


def test_a_camera_with_a_fifth_coefficient_of_zero_is_written_with_four_coefficients(tmp_path):
    camera = replace(CAMERAS["radtan5"], distortion=(-0.2, 0.05, 1e-3, -5e-4, 0.0))
    read = read_by_colmap(tmp_path, replace(make_map("radtan"), camera=camera)).cameras[1]
    assert read.model.name == "OPENCV"
    np.testing.assert_allclose(read.params[4:], camera.distortion[:4])


def test_numbers_have_twelve_significant_digits():
    assert numbers_text([1 / 3, 1e-9, 2.0]) == "0.333333333333 1e-09 2"
