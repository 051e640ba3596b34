"""Errors that neighbours share: measured where they are, not invented where they are not."""

import numpy as np
import pytest

from quest.estimate import RelativePose, estimate_relative_pose
from quest.robust.spatial_blocks import directions_of, regions_of, scatter_of_sum
from slam_init.decision.correlated_error import rounding_error_px, shared_error_rad

NOISE = 1e-3
T = np.array([0.3, 0.05, 0.02])


def views(shared, noise=NOISE, count=600, seed=0):
    """Bearings of a translating camera; the second view has noise and a smooth field of errors with this deviation."""
    rng = np.random.default_rng(seed)
    x = rng.uniform([-0.7, -0.5], [0.7, 0.5], (count, 2))
    X = np.column_stack([x, np.ones(count)]) * rng.uniform(1, 4, (count, 1))
    Y = X + T
    field = np.column_stack([np.sin(9 * x[:, 0] + 4 * x[:, 1]), np.cos(7 * x[:, 1] - 5 * x[:, 0])])
    y = Y[:, :2] / Y[:, 2:] + np.sqrt(2) * shared * field + rng.normal(0, noise, (count, 2))
    m, n = (np.column_stack([a, np.ones(count)]) for a in (x + rng.normal(0, noise, (count, 2)), y))
    return m / np.linalg.norm(m, axis=1, keepdims=True), n / np.linalg.norm(n, axis=1, keepdims=True), x


def measured(shared, **options):
    m, n, x = views(shared, **options)
    pose = estimate_relative_pose(m, n, threshold_rad=2e-2)
    assert isinstance(pose, RelativePose)
    return shared_error_rad(pose, m, n, x)


@pytest.mark.parametrize("shared", [1e-3, 4e-3])
def test_an_error_that_neighbours_share_is_measured(shared):
    # A Sampson error has one component, and a half of the error's square is that of the second view.
    assert measured(shared) == pytest.approx(shared / np.sqrt(2), rel=0.4)


def test_noise_of_single_tracks_is_no_shared_error():
    assert max(measured(0.0, seed=seed) for seed in range(5)) < 0.3 * NOISE


def test_the_more_tracks_the_less_may_be_hidden():
    few, many = (np.median([measured(0.0, count=count, seed=seed) for seed in range(5)]) for count in (80, 2000))
    assert many < 0.5 * few


def test_tracks_without_neighbours_say_nothing_and_all_of_the_gate_is_feared():
    m, n, x = views(0.0, count=40)
    pose = estimate_relative_pose(m, n, threshold_rad=2e-2)
    spread = np.column_stack([np.arange(len(x)) % 8, np.arange(len(x)) // 8]).astype(float)
    assert len(np.unique(regions_of(spread))) == len(x)
    assert shared_error_rad(pose, m, n, spread) == pytest.approx(3 * pose.noise_rad)


def test_whole_pixels_are_rounded_ones():
    pixels = np.random.default_rng(0).uniform(0, 640, (500, 2))
    assert rounding_error_px(pixels) == 0
    assert rounding_error_px(np.zeros((0, 2))) == 0
    error = rounding_error_px(np.round(pixels))
    assert error == pytest.approx(np.std(np.round(pixels) - pixels), rel=0.05)
    # ORB: whole pixels in the first octave, multiples of 1.2 in the next ones.
    pixels[:100] = np.round(pixels[:100])
    assert rounding_error_px(pixels) == error


def test_regions_split_the_view_and_a_sum_of_alike_neighbours_scatters_more():
    rng = np.random.default_rng(0)
    where = rng.uniform(-1, 1, (4800, 2))
    region = regions_of(where)
    assert len(np.unique(region)) == 48
    assert (np.abs(np.bincount(region) - 100) < 50).all()
    single = rng.choice([-1.0, 1.0], 4800)
    by_region = rng.choice([-1.0, 1.0], 48)[region]
    assert scatter_of_sum(single, where) == pytest.approx(np.sqrt(4800), rel=0.2)
    assert scatter_of_sum(by_region, where) > 5 * np.sqrt(4800)
    assert scatter_of_sum(np.zeros(4800), where) == 0
    assert scatter_of_sum(np.zeros(0), np.zeros((0, 2))) == 0


def test_directions_all_around_keep_their_neighbours():
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(300, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    near = rays + 1e-4 * rng.normal(size=rays.shape)
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    moved = np.linalg.norm(directions_of(near) - directions_of(rays), axis=1)
    # The scale of the projection at a ray is 1 / (1 + z).
    assert (moved * (1 + rays[:, 2]) < 1e-3).all()
