"""The standard error of a direction from parts of the view: for independent noise, and with a moving body."""

from dataclasses import replace

import numpy as np
import pytest

from quest.errors import InputError
from quest.estimate import RelativePose, estimate_relative_pose
from quest.jackknife import direction_spread_rad

NOISE = 1e-3
T = np.array([0.1, 0.02, 0.01])


def unit(rays):
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def views(seed=0, noise=NOISE, body_shift=(0, 0, 0), count=600, extent=(0.7, 0.5)):
    """Bearings of a translating camera; the points in the left fifth of the view are a moving body."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-np.array(extent), extent, (count, 2))
    X = np.column_stack([x, np.ones(count)]) * rng.uniform(1, 4, (count, 1))
    Y = X + T + np.where(x[:, :1] < -0.6 * extent[0], body_shift, 0)
    m, n = (rays[:, :2] / rays[:, 2:] + rng.normal(0, noise, (count, 2)) for rays in (X, Y))
    return unit(np.column_stack([m, np.ones(count)])), unit(np.column_stack([n, np.ones(count)]))


def estimate(m, n):
    pose = estimate_relative_pose(m, n, threshold_rad=5e-3)
    assert isinstance(pose, RelativePose)
    assert pose.kind != "rotation"
    return pose


def test_for_independent_noise_the_spread_is_the_standard_deviation():
    ratios = []
    for seed in range(12):
        m, n = views(seed)
        pose = estimate(m, n)
        ratios.append(direction_spread_rad(pose, m, n) / pose.direction_sigma_rad)
    # Each value has an error of about a fifth, from a dozen fits; a jackknife is rather too large.
    assert 0.8 < np.median(ratios) < 1.5
    assert max(ratios) < 3


def test_exact_matches_have_no_spread():
    m, n = views(noise=0)
    assert direction_spread_rad(estimate(m, n), m, n) < 1e-5


def test_a_moving_body_raises_the_spread_but_not_the_residuals():
    by_jackknife, by_residuals = [], []
    for seed in range(5):
        m, n = views(seed, body_shift=(0, 0.01, 0))
        pose = estimate(m, n)
        assert pose.inliers.mean() > 0.95  # most matches of the body are inliers
        error = np.arccos(pose.t @ T / np.linalg.norm(T))
        by_jackknife.append(error / direction_spread_rad(pose, m, n))
        by_residuals.append(error / pose.direction_sigma_rad)
    assert np.median(by_residuals) > 3.5  # practically impossible by the standard deviation
    assert np.median(by_jackknife) < 2


def test_the_spread_is_infinite_where_the_matches_outside_of_one_part_fix_no_motion():
    m, n = views()
    pose = estimate(m, n)
    same = np.repeat(m[:1], len(m), axis=0)
    assert direction_spread_rad(pose, same, n) == np.inf
    # A dozen matches far off, all of one ray: without the other matches they fix no motion.
    by_distance = np.argsort(np.linalg.norm(m - unit(np.array([[0.5, 0.35, 1.0]])), axis=1))
    kept = np.concatenate([by_distance[:60], np.repeat(by_distance[-1:], 12)])
    # Every ray along the translation: no residual depends on the motion.
    along = np.repeat(pose.t[None], len(m), axis=0)
    assert direction_spread_rad(pose, along, along @ pose.R.T) == np.inf
    crowded = replace(pose, inliers=np.ones(len(kept), bool))
    assert direction_spread_rad(crowded, m[kept], n[kept]) == np.inf


def test_parts_of_unequal_size_have_the_right_weights():
    """Half of the matches lie in a twentieth of the view: the standard error is that of the noise."""
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        x = rng.uniform([-0.7, -0.5], [0.7, 0.5], (600, 2))
        x[:300] = [0.5, 0.3] + 0.1 * x[:300]
        X = np.column_stack([x, np.ones(600)]) * rng.uniform(1, 4, (600, 1))
        m, n = (rays[:, :2] / rays[:, 2:] + rng.normal(0, NOISE, (600, 2)) for rays in (X, X + T))
        m, n = (unit(np.column_stack([rays, np.ones(600)])) for rays in (m, n))
        pose = estimate(m, n)
        ratios.append(direction_spread_rad(pose, m, n) / pose.direction_sigma_rad)
    assert 0.7 < np.median(ratios) < 1.6


def test_wrong_arguments_are_refused():
    m, n = views()
    pose = estimate(m, n)
    with pytest.raises(InputError, match="give the 600 matches"):
        direction_spread_rad(pose, m[:100], n[:100])
    rotation = estimate_relative_pose(m, m, threshold_rad=5e-3)
    assert rotation.kind == "rotation"
    with pytest.raises(InputError, match="no direction"):
        direction_spread_rad(rotation, m, m)
