"""Laws of the compiled projection: it equals :meth:`Camera.project`, and its derivatives are those of the pixel."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS

from slam_init.window.projection import camera_vector, project_point

MODELS = list(CAMERAS)


def projected(camera, point, scale=1.0, k1=0.0):
    """Whether the lens sees the point, its pixel, and the derivatives; NaN where it does not."""
    seen, *numbers = project_point(camera_vector(camera), scale, k1, *map(float, point))
    numbers = np.array(numbers) if seen else np.full(10, np.nan)
    return seen, numbers[:2], np.column_stack([numbers[2:8].reshape(2, 3), numbers[8:]])


def points_ahead(count=50, width=1.2):
    rng = np.random.default_rng(5)
    return rng.uniform([-width, -width, 0.8], [width, width, 3.0], (count, 3))


@pytest.mark.parametrize("model", MODELS)
def test_the_pixel_is_that_of_the_camera(model):
    camera = CAMERAS[model]
    points = np.vstack([points_ahead(), [[0, 0, 2.0], [1e-9, -1e-9, 1.0]]])
    for point, expected in zip(points, camera.project(points), strict=True):
        seen, pixel, _ = projected(camera, point)
        assert seen == np.isfinite(expected).all()
        if seen:
            np.testing.assert_allclose(pixel, expected, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_a_focal_scale_is_a_camera_with_a_longer_focal_length(model):
    camera = CAMERAS[model]
    longer = replace(camera, fx=1.03 * camera.fx, fy=1.03 * camera.fy)
    for point in points_ahead(10, width=0.5):
        np.testing.assert_allclose(projected(camera, point, 1.03)[1], projected(longer, point)[1], atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_the_derivatives_are_central_differences(model):
    camera, step = CAMERAS[model], 1e-6
    for point in np.vstack([points_ahead(20, width=0.7), [[0, 0, 2.0], [1e-5, 2e-5, 1.0]]]):
        _, _, by_point = projected(camera, point)
        for axis in range(3):
            ahead, behind = point.copy(), point.copy()
            ahead[axis] += step
            behind[axis] -= step
            difference = (projected(camera, ahead)[1] - projected(camera, behind)[1]) / (2 * step)
            np.testing.assert_allclose(by_point[:, axis], difference, atol=1e-4)
        difference = (projected(camera, point, k1=step)[1] - projected(camera, point, k1=-step)[1]) / (2 * step)
        np.testing.assert_allclose(by_point[:, 3], difference, atol=1e-4)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("k1", [-0.1, 0.05])
def test_a_coefficient_that_is_added_is_that_of_a_bent_camera(model, k1):
    camera = CAMERAS[model]
    for point in points_ahead(10, width=0.5):
        expected = camera.bent(k1).project(point[None])[0]
        np.testing.assert_allclose(projected(camera, point, k1=k1)[1], expected, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("point", [(0.1, 0.2, -1.0), (0.1, 0.2, 0.0), (0.0, 0.0, -1e-12)])
def test_a_point_that_is_not_in_front_is_not_seen_and_nothing_is_written(model, point):
    seen, pixel, by_point = projected(CAMERAS[model], point)
    assert not seen
    assert np.isnan(pixel).all()
    assert np.isnan(by_point).all()


@pytest.mark.parametrize("model", ["radtan", "radtan5", "fisheye"])
def test_the_lens_sees_up_to_its_largest_angle(model):
    camera = CAMERAS[model]
    if model != "fisheye":  # with k1 alone the lens polynomial stops growing at 1 / sqrt(3 |k1|)
        camera = replace(camera, distortion=(-0.2, *([0.0] * (len(camera.distortion) - 1))))
        assert camera.max_tangent == pytest.approx(1 / np.sqrt(0.6))
    direction = np.array([np.cos(0.7), np.sin(0.7)])
    for factor, visible in ((0.999, True), (1.001, False)):
        point = (*(factor * camera.max_tangent * direction), 1.0)
        seen, pixel, _ = projected(camera, point)
        assert seen is visible
        assert np.isfinite(pixel).all() == visible
        assert np.isfinite(camera.project(np.array([point]))).all() == visible
