"""Laws of the correlated tracking error: it is measured if neighbours have errors in common, and small if not."""

import numpy as np
import pytest

from quest.estimate import RelativePose, estimate_relative_pose
from quest.robust.spatial_blocks import regions_of
from slam_init.decision.correlated_error import correlated_error_rad, rounding_error_px

NOISE = 1e-3
T = np.array([0.3, 0.05, 0.02])


def views(correlated, noise=NOISE, count=600, seed=0):
    """Bearings of a translating camera. The second view has noise and a smooth field of errors of this deviation."""
    rng = np.random.default_rng(seed)
    x = rng.uniform([-0.7, -0.5], [0.7, 0.5], (count, 2))
    X = np.column_stack([x, np.ones(count)]) * rng.uniform(1, 4, (count, 1))
    Y = X + T
    field = np.column_stack([np.sin(9 * x[:, 0] + 4 * x[:, 1]), np.cos(7 * x[:, 1] - 5 * x[:, 0])])
    y = Y[:, :2] / Y[:, 2:] + np.sqrt(2) * correlated * field + rng.normal(0, noise, (count, 2))
    m, n = (np.column_stack([a, np.ones(count)]) for a in (x + rng.normal(0, noise, (count, 2)), y))
    return m / np.linalg.norm(m, axis=1, keepdims=True), n / np.linalg.norm(n, axis=1, keepdims=True), x


def measured(correlated, **options):
    m, n, x = views(correlated, **options)
    pose = estimate_relative_pose(m, n, threshold_rad=2e-2)
    assert isinstance(pose, RelativePose)
    return correlated_error_rad(pose, m, n, x)


@pytest.mark.parametrize("correlated", [1e-3, 4e-3])
def test_an_error_that_neighbours_have_in_common_is_measured(correlated):
    # A Sampson error has one component, and only the second of the two views has the correlated error.
    assert measured(correlated) == pytest.approx(correlated / np.sqrt(2), rel=0.4)


def test_the_noise_of_single_tracks_is_not_a_correlated_error():
    assert max(measured(0.0, seed=seed) for seed in range(5)) < 0.3 * NOISE


def test_more_tracks_lower_the_upper_estimate():
    few, many = (np.median([measured(0.0, count=count, seed=seed) for seed in range(5)]) for count in (80, 2000))
    assert many < 0.5 * few


def test_without_neighbours_the_estimate_is_three_standard_deviations_of_the_noise():
    m, n, x = views(0.0, count=40)
    pose = estimate_relative_pose(m, n, threshold_rad=2e-2)
    spread = np.column_stack([np.arange(len(x)) % 8, np.arange(len(x)) // 8]).astype(float)
    assert len(np.unique(regions_of(spread))) == len(x)
    assert correlated_error_rad(pose, m, n, spread) == pytest.approx(3 * pose.noise_rad)


def test_whole_pixels_have_the_error_of_rounding():
    pixels = np.random.default_rng(0).uniform(0, 640, (500, 2))
    assert rounding_error_px(pixels) == 0
    assert rounding_error_px(np.zeros((0, 2))) == 0
    error = rounding_error_px(np.round(pixels))
    assert error == pytest.approx(np.std(np.round(pixels) - pixels), rel=0.05)
    # As for ORB: a part of the pixels is whole, those of the first octave.
    pixels[:100] = np.round(pixels[:100])
    assert rounding_error_px(pixels) == error
