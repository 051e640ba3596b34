"""How much a direction hangs on single parts of the view: right for noise, and for a body that bends the motion."""

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
    """Bearings of a translating camera; what lies in the left fifth of the view moves by itself."""
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


def test_of_independent_noise_it_is_the_standard_deviation():
    ratios = []
    for seed in range(12):
        m, n = views(seed)
        pose = estimate(m, n)
        ratios.append(direction_spread_rad(pose, m, n) / pose.direction_sigma_rad)
    # Each is known to about a fifth, from a dozen fits; a jackknife rather says too much.
    assert 0.8 < np.median(ratios) < 1.5
    assert max(ratios) < 3


def test_exact_matches_leave_no_spread():
    m, n = views(noise=0)
    assert direction_spread_rad(estimate(m, n), m, n) < 1e-5


def test_a_body_that_bends_the_motion_shows_where_the_residuals_do_not():
    told, known = [], []
    for seed in range(5):
        m, n = views(seed, body_shift=(0, 0.01, 0))
        pose = estimate(m, n)
        assert pose.inliers.mean() > 0.95  # most of the body is explained as well
        error = np.arccos(pose.t @ T / np.linalg.norm(T))
        told.append(error / direction_spread_rad(pose, m, n))
        known.append(error / pose.direction_sigma_rad)
    assert np.median(known) > 3.5  # by its standard deviation such an error does not happen
    assert np.median(told) < 2


def test_where_one_part_holds_all_that_is_known_nothing_can_be_said():
    m, n = views()
    pose = estimate(m, n)
    same = np.repeat(m[:1], len(m), axis=0)
    assert direction_spread_rad(pose, same, n) == np.inf
    # A dozen matches far off, all of one ray: without the rest they fix no motion.
    by_distance = np.argsort(np.linalg.norm(m - unit(np.array([[0.5, 0.35, 1.0]])), axis=1))
    kept = np.concatenate([by_distance[:60], np.repeat(by_distance[-1:], 12)])
    # Every ray along the translation: no residual depends on the motion.
    along = np.repeat(pose.t[None], len(m), axis=0)
    assert direction_spread_rad(pose, along, along @ pose.R.T) == np.inf
    crowded = replace(pose, inliers=np.ones(len(kept), bool))
    assert direction_spread_rad(crowded, m[kept], n[kept]) == np.inf


def test_parts_of_unequal_size_weigh_as_much_as_they_should():
    """Half of the matches crowd in a twentieth of the view: the standard error is still that of the noise."""
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


def test_a_wrong_call_is_told():
    m, n = views()
    pose = estimate(m, n)
    with pytest.raises(InputError, match="give the 600 matches"):
        direction_spread_rad(pose, m[:100], n[:100])
    turned = estimate_relative_pose(m, m, threshold_rad=5e-3)
    assert turned.kind == "rotation"
    with pytest.raises(InputError, match="no direction"):
        direction_spread_rad(turned, m, m)
