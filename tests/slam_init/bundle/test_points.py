"""Points that are fitted robustly to their rays, for poses that are known."""

from dataclasses import replace

import numpy as np
import pytest
import reference_points
from make_map import CAMERAS
from make_scene import CAMERA, cloud, problem

from slam_init.bundle.least_squares import with_lenses
from slam_init.bundle.points import fit_points


def moved(exact, rng, share=0.05):
    """The same observations with points at other distances."""
    return replace(exact, points=exact.points * rng.normal(1, share, (len(exact.points), 1)))


def errors(found, exact):
    return np.linalg.norm(found.points - exact.points, axis=1)


@pytest.mark.parametrize("model", CAMERAS)
def test_without_noise_moved_points_return_to_the_truth(model):
    rng = np.random.default_rng(0)
    exact = problem(CAMERAS[model], cloud(rng))
    found = fit_points(CAMERAS[model], moved(exact, rng), 0.5)
    assert np.median(errors(found, exact)) < 1e-3 * np.median(errors(moved(exact, rng), exact))
    assert found.world_from_cam == exact.world_from_cam


def test_an_outlier_pulls_a_point_far_less_than_in_least_squares():
    """One view of each point is off by 30 px; as an inlier it would move the point by a fifth of that."""
    rng = np.random.default_rng(1)
    exact = problem(CAMERA, cloud(rng))
    pixels = exact.pixels.copy()
    pixels[exact.views == 2] += (30.0, 0.0)
    wrong = replace(exact, pixels=pixels)
    robust, plain = (fit_points(CAMERA, wrong, noise_px) for noise_px in (0.5, 1e6))
    assert np.median(errors(robust, exact)) < 0.1 * np.median(errors(plain, exact))


def test_no_point_moves_behind_a_camera_or_to_infinity():
    rng = np.random.default_rng(2)
    exact = problem(CAMERA, cloud(rng))
    noisy = replace(exact, pixels=exact.pixels + 40 * rng.normal(size=exact.pixels.shape))
    found = fit_points(CAMERA, noisy, 0.5)
    assert np.isfinite(found.points).all()
    for k, pose in enumerate(found.world_from_cam):
        seen = found.landmarks[found.views == k]
        assert (pose.inverse().apply(found.points[seen])[:, 2] > 0).all()


@pytest.mark.parametrize("model", CAMERAS)
@pytest.mark.parametrize("noise_px", [0.5, 40.0])
def test_the_compiled_loop_moves_the_points_as_numpy_does(model, noise_px):
    """With 40 px many a step is refused, since it would move its point behind a camera."""
    rng = np.random.default_rng(3)
    exact = problem(CAMERAS[model], cloud(rng))
    noisy = moved(replace(exact, pixels=exact.pixels + noise_px * rng.normal(size=exact.pixels.shape)), rng, 0.2)
    noisy = noisy.keep(
        np.isfinite(CAMERAS[model].bearings(noisy.pixels)).all(axis=1) & (rng.random(len(noisy.views)) < 0.8)
    )
    expected = reference_points.fit_points(CAMERAS[model], noisy, 0.5)
    for start in (noisy, with_lenses(CAMERAS[model], noisy)):
        found = fit_points(CAMERAS[model], start, 0.5)
        np.testing.assert_allclose(found.points, expected.points, rtol=1e-6, atol=1e-8)
