"""Laws of the parts: lens, shutter and hand motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences_synth.camera import Shutter, SynthCamera
from sequences_synth.trajectory import (
    rotation_from_vector,
    rotations_from_vectors,
    vector_from_rotation,
)

SEEDS = st.integers(0, 2**32 - 1)


CAMERA = SynthCamera(640, 480, 458.0, 458.0, 319.5, 239.5)


@settings(max_examples=15)
@given(SEEDS, st.floats(-0.2, 1.0))
def test_the_ray_of_a_pixel_projects_to_the_pixel(seed, k1):
    lens = CAMERA.bent(k1)
    pixels = np.random.default_rng(seed).uniform((0, 0), (639, 479), (50, 2))
    rays = lens.rays(pixels)
    seen = rays[:, 2] > 0
    # A strong barrel distortion leaves the corners of the image black.
    assert seen[np.linalg.norm(pixels - [319.5, 239.5], axis=1) < 0.8 * 458].all()
    np.testing.assert_allclose(lens.project(rays[seen]), pixels[seen], atol=1e-6)


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
