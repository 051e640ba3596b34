"""Lenses of the synthetic worlds: their rays are those of OpenCV and of the calibrations that are read back."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from sequences_synth import LENSES, write_tum
from sequences_synth.camera import all_sights, lens_camera
from slam_init.calibration.files import load_camera
from slam_init.datasets.synth import open_synth
from slam_init.types.camera import Camera


@pytest.mark.parametrize("model", LENSES)
def test_the_rays_of_the_pixels_are_those_of_the_camera_of_the_source_and_of_opencv(model, tmp_path):
    lens = lens_camera(model, 96, 72)
    rays = np.stack(all_sights(lens, 1), axis=-1)
    seen = (rays != 0).any(axis=-1)
    assert seen.mean() > 0.85
    rows, columns = np.nonzero(seen)
    pixels = np.column_stack([columns, rows]).astype(float)
    camera = Camera(model, 96, 72, lens.fx, lens.fy, lens.cx, lens.cy, lens.coefficients)
    np.testing.assert_allclose(camera.bearings(pixels), rays[seen], atol=1e-8)
    np.testing.assert_allclose(lens.project(rays[seen]), pixels, atol=1e-6)
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    ahead = rays[seen][:, 2] > 0.1
    points = (rays[seen][ahead] / rays[seen][ahead, 2:]).reshape(-1, 1, 3)
    zero = np.zeros(3)
    arguments = (camera.K, np.array(lens.coefficients))
    by_opencv = project(points, zero, zero, *arguments)[0].reshape(-1, 2)
    np.testing.assert_allclose(by_opencv, pixels[ahead], atol=1e-5)
    assert not np.stack(all_sights(replace(lens, half_field_rad=0.3), 1))[:, 0, 0].any()
    # A written sequence states its lens.
    source = open_synth(f"synth:wall?lens={model}&frames=1&width=64&height=64&noise=0", 0)
    write_tum(source.sequence, tmp_path / "out")
    assert load_camera(tmp_path / "out" / "camera.yaml") == replace(source.camera, source="file")
