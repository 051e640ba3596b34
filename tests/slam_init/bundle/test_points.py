"""Points that are fitted robustly to their rays, for poses that are known."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS
from make_scene import CAMERA, cloud, problem

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
