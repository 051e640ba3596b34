"""Laws of the compiled projection; ``test_lens`` and ``test_camera`` compare it with other programs."""

from dataclasses import replace

import numpy as np
import pytest
from make_lenses import LENSES as OTHER_LENSES
from make_lenses import directions
from make_map import CAMERAS

from slam_init.lenses.point import project_point

LENSES = OTHER_LENSES | {f"narrow {name}": camera for name, camera in CAMERAS.items()}


def projected(camera, point, scale=1.0, k1=0.0):
    """Whether the lens sees the point, its pixel, and the derivatives; NaN where it does not."""
    seen, *numbers = project_point(camera.numbers, scale, k1, *map(float, point))
    numbers = np.array(numbers) if seen else np.full(10, np.nan)
    return seen, numbers[:2], np.column_stack([numbers[2:8].reshape(2, 3), numbers[8:]])


@pytest.mark.parametrize("model", LENSES)
def test_many_points_have_the_numbers_of_each(model):
    camera, points = LENSES[model], np.vstack([3.0 * directions(60), [[0, 0, 2.0], [0, 0, -1.0], [0, 0, 0.0]]])
    found, moved = camera.differentiated(points), camera.moved_pixels(points, points[::-1])
    for n, point in enumerate(points):
        seen, pixel, derivatives = projected(camera, point)
        np.testing.assert_array_equal(found.pixels[n], pixel)
        np.testing.assert_array_equal(np.column_stack([found.by_point[n], found.by_k1[n]]), derivatives)
        np.testing.assert_allclose(moved[n], derivatives[:, :3] @ points[-1 - n] if seen else 0.0, atol=1e-9)


@pytest.mark.parametrize("model", LENSES)
def test_the_derivatives_are_central_differences_in_all_directions(model):
    camera, step = LENSES[model], 1e-6
    compared = 0
    for point in np.vstack([2.0 * directions(30), [[0, 0, 2.0], [1e-5, 2e-5, 1.0], [1e-7, 2e-7, 1.0]]]):
        derivatives = projected(camera, point)[2]
        moved = [
            (projected(camera, point + shift)[1] - projected(camera, point - shift)[1]) / (2 * step)
            for shift in step * np.eye(3)
        ]
        moved.append((projected(camera, point, k1=step)[1] - projected(camera, point, k1=-step)[1]) / (2 * step))
        differences = np.column_stack(moved)
        if np.isfinite(differences).all():
            np.testing.assert_allclose(derivatives, differences, rtol=1e-4, atol=1e-4)
            compared += 1
    assert compared >= 10


@pytest.mark.parametrize("model", LENSES)
def test_a_scaled_and_bent_lens_is_that_of_the_camera(model):
    camera = LENSES[model]
    longer = replace(camera, fx=1.03 * camera.fx, fy=1.03 * camera.fy).bent(0.02)
    rays = directions(30)
    for ray, expected in zip(rays, longer.project(rays), strict=True):
        seen, pixel, _ = projected(camera, ray, 1.03, 0.02)
        if seen and np.isfinite(expected).all():
            np.testing.assert_allclose(pixel, expected, atol=1e-9)
