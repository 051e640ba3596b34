"""Cameras of which one number is known, or none."""

import math

import numpy as np
import pytest

from slam_init.calibration.files import load_camera, prior_camera
from slam_init.errors import CalibrationError

SIZE = (640, 480)


def test_of_an_unknown_camera_the_size_is_known_and_the_focal_length_within_a_factor_of_four():
    camera = prior_camera(SIZE)
    assert (camera.width, camera.height, camera.cx, camera.cy, camera.source) == (*SIZE, 319.5, 239.5, "prior")
    # Two standard deviations hold 40 to 95 degrees across.
    for fov_deg in (40, 60, 80, 95):
        focal_px = 320 / math.tan(math.radians(fov_deg / 2))
        assert abs(math.log(focal_px / camera.fx)) < 2 * camera.focal_sigma


@pytest.mark.parametrize("text", ["auto", "guess"])
def test_auto_is_the_prior(text):
    assert load_camera(text, SIZE) == prior_camera(SIZE)


def test_a_number_is_a_focal_length_or_a_field_of_view_across_the_longer_side():
    by_focal = load_camera("f=700", SIZE)
    assert (by_focal.fx, by_focal.fy, by_focal.source) == (700, 700, "stated")
    assert by_focal.focal_sigma < prior_camera(SIZE).focal_sigma
    by_field = load_camera("fov=90", SIZE)
    np.testing.assert_allclose(by_field.fx, 320)
    assert load_camera("fov=90", SIZE[::-1]).fx == by_field.fx


@pytest.mark.parametrize("text", ["f=", "f=x", "f=nan", "f=-5", "f=0.1", "fov=0", "fov=180", "fov=inf", "fov=wide"])
def test_a_number_of_no_camera_is_refused_in_one_line(text):
    with pytest.raises(CalibrationError, match=r"focal|degrees") as error:
        load_camera(text, SIZE)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["auto", "f=700", "fov=90"])
def test_without_images_there_is_no_size(text):
    with pytest.raises(CalibrationError, match="size"):
        load_camera(text)
