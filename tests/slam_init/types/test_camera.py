"""Projection and bearings are inverse to each other and agree with OpenCV; impossible cameras are refused."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

PINHOLE = Camera("pinhole", 640, 480, 525.0, 520.0, 319.5, 239.5)
EUROC = Camera("radtan", 752, 480, 458.654, 457.296, 367.215, 248.375, (-0.28340811, 0.07395907, 1.9e-4, 1.8e-5))
FREIBURG = Camera("radtan", 640, 480, 517.3, 516.5, 318.6, 255.3, (0.262383, -0.953104, -0.005358, 0.002628, 1.163314))
FISHEYE = Camera("fisheye", 640, 480, 320.0, 321.0, 318.0, 241.0, (0.05, 0.01, -0.004, 0.001))
CAMERAS = [PINHOLE, EUROC, FREIBURG, FISHEYE]


def grid(camera: Camera) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 23), np.linspace(0, camera.height - 1, 17))
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_projecting_a_bearing_gives_its_pixel_up_to_the_corners(camera):
    pixels = grid(camera)
    rays = camera.bearings(pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(camera.project(7.5 * rays), pixels, atol=1e-9)


@settings(max_examples=50)
@given(
    st.floats(-0.35, 0.35),
    st.floats(-0.005, 0.005),
    st.floats(-0.005, 0.005),
    st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.45, 0.45)), min_size=1, max_size=20),
)
def test_undistorting_inverts_distorting_for_every_monotonic_lens(k1, p1, p2, xy):
    camera = Camera("radtan", 640, 480, 500, 500, 320, 240, (k1, 0.1, p1, p2))
    xy = np.array(xy)
    pixels = camera.project(np.column_stack([xy, np.ones(len(xy))]))
    np.testing.assert_allclose(camera.normalize(pixels), xy, atol=1e-8)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_projection_agrees_with_opencv(camera):
    points = np.random.default_rng(1).uniform([-1, -0.8, 1.5], [1, 0.8, 4], (200, 3))
    zero, coefficients = np.zeros(3), np.array(camera.distortion or [0.0] * 4)
    if camera.model == "fisheye":
        expected, _ = cv2.fisheye.projectPoints(points[None], zero, zero, camera.K, coefficients)
    else:
        expected, _ = cv2.projectPoints(points, zero, zero, camera.K, coefficients)
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)


def test_points_that_the_lens_does_not_see_project_to_nan_and_no_points_to_no_pixels():
    behind = np.array([[0.1, 0.2, -1.0], [0.0, 0.0, 0.0]])
    for camera in CAMERAS:
        assert np.isnan(camera.project(behind)).all()
        assert camera.bearings(np.zeros((0, 2))).shape == (0, 3)
        assert camera.project(np.zeros((0, 3))).shape == (0, 2)


def test_a_barrel_lens_does_not_map_points_outside_of_its_field_of_view_into_the_image():
    # r (1 - 0.4 r^2) stops growing at r = sqrt(1 / 1.2) = 0.913. It would map a point at r = 1.5 into the image.
    camera = Camera("radtan", 640, 480, 400, 400, 320, 240, (-0.4, 0.0, 0.0, 0.0))
    assert np.isfinite(camera.project(np.array([[0.9, 0.0, 1.0]]))).all()
    assert np.isnan(camera.project(np.array([[1.5, 0.0, 1.0]]))).all()


def test_pixels_without_a_ray_are_nan_and_do_not_affect_others():
    camera = Camera("radtan", 640, 480, 400, 400, 320, 240, (-0.4, 0.0, 0.0, 0.0))
    # The largest distorted radius is 0.913 (1 - 1/3) = 0.609: 243 px from the centre.
    xy = camera.normalize(np.array([[320.0 + 250.0, 240.0], [320.0 + 240.0, 240.0], [320.0, 240.0]]))
    assert np.isnan(xy).all(axis=1).tolist() == [True, False, False]
    fisheye = Camera("fisheye", 640, 480, 150, 150, 320, 240, (0.0, 0.0, 0.0, 0.0))
    # Equidistant: 150 px per radian, so that 90 degrees lie 236 px from the centre.
    xy = fisheye.normalize(np.array([[320.0 + 240.0, 240.0], [320.0 + 150 * math.radians(80), 240.0]]))
    assert np.isnan(xy).all(axis=1).tolist() == [True, False]
    assert xy[1, 0] == pytest.approx(math.tan(math.radians(80)))


def test_a_scaled_camera_has_the_same_rays_in_the_resized_image():
    half = EUROC.scaled(0.5)
    assert (half.width, half.height) == (376, 240)
    pixels = grid(EUROC)
    # Pixel centres at integers: the image spans -0.5 to width - 0.5.
    np.testing.assert_allclose(half.bearings((pixels + 0.5) / 2 - 0.5), EUROC.bearings(pixels), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"fx": 0.0}, "fx"),
        ({"fy": -480.0}, "fy"),
        ({"fx": math.nan}, "fx"),
        ({"fy": math.inf}, "fy"),
        ({"cx": math.nan}, "cx"),
        ({"width": 0}, "size"),
        ({"model": "magic"}, "magic"),
        ({"distortion": (0.1,)}, "coefficients"),
        ({"model": "radtan", "distortion": (0.1, math.nan, 0, 0)}, "finite"),
        *(({"model": "radtan", "distortion": (0.0, k, 0.0, 0.0)}, "distortion") for k in (1e308, -1e308, 1e7)),
        ({"width": 10**7}, "1000000 pixels a side"),
        ({"model": "fov", "distortion": (0.0,)}, "w of a fov"),
        ({"model": "fov", "distortion": (3.2,)}, "w of a fov"),
        ({"model": "omni", "distortion": (-0.5,)}, "xi"),
        ({"model": "omni", "distortion": (1.0, 0.1)}, "give 1 or 5"),
        ({"model": "double-sphere", "distortion": (-1.0, 0.5)}, "xi"),
        ({"model": "double-sphere", "distortion": (0.0, 1.0)}, "alpha"),
        ({"model": "double-sphere", "distortion": (0.1,)}, "xi alpha"),
        ({"model": "eucm", "distortion": (1.1, 1.0)}, "alpha"),
        ({"model": "eucm", "distortion": (0.5, 0.0)}, "beta"),
        ({"model": "rational", "distortion": (0.1, 0.2, 0.0, 0.0)}, "give 8"),
        ({"model": "equirectangular", "distortion": (0.1,)}, "give 0"),
        ({"model": "eucm", "distortion": (math.nan, 1.0)}, "finite"),
    ],
)
def test_an_impossible_parameter_is_refused_by_name(change, word):
    values = {"model": "pinhole", "width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(CalibrationError, match=word):
        Camera(**(values | change))
