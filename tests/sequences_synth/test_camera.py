"""Laws of the parts: lens, shutter and hand motion."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences_synth import write_tum
from sequences_synth.camera import LENSES, Shutter, all_sights, lens_camera
from sequences_synth.trajectory import (
    rotation_from_vector,
    rotations_from_vectors,
    vector_from_rotation,
)
from slam_init.calibration.files import load_camera
from slam_init.datasets.synth import open_synth
from slam_init.types.camera import Camera

SEEDS = st.integers(0, 2**32 - 1)


def test_the_shutter_runs_in_its_direction_and_the_middle_has_the_time_of_the_frame():
    top, bottom, left, right = (5, 0), (5, 480), (0, 5), (640, 5)
    for direction, early, late in (
        ("down", top, bottom),
        ("up", bottom, top),
        ("right", left, right),
        ("left", right, left),
    ):
        shutter = Shutter(0.03, direction, 640, 480)
        assert shutter.delay_s(np.array([early, late, (320.0, 240.0)])) == pytest.approx([-0.015, 0.015, 0.0])


@settings(max_examples=15)
@given(SEEDS)
def test_rotations_of_many_vectors_are_those_of_each_and_the_logarithm_inverts_them(seed):
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(6, 3))
    vectors *= rng.uniform(0, 3.0, (6, 1)) / np.linalg.norm(vectors, axis=1, keepdims=True)
    vectors[0] = 0.0
    vectors[1] *= 1e-9
    for vector, rotation in zip(vectors, rotations_from_vectors(vectors), strict=True):
        np.testing.assert_allclose(rotation, rotation_from_vector(vector), atol=1e-14)
        np.testing.assert_allclose(vector_from_rotation(rotation), vector, atol=1e-7)


# -- lenses ----------------------------------------------------------------------------------------


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
