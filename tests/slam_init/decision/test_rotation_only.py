"""A camera that only turns, whose stated focal length may be wrong, told from a translation before a wall."""

from dataclasses import replace

import numpy as np
import pytest

from quest.geometry.quaternion import rotation_from_vector
from slam_init.decision.calibration_check import TurningCamera, suspected_focal_factor, turning_camera

NOISE = 1e-3
TURN = rotation_from_vector(np.array([0.03, 0.2, 0.01]))


def matches(R, t, factor=1.0, depth=None, seed=0, count=400):
    """Bearings under the stated calibration of a camera with another focal length; depth (N,) of the points."""
    rng = np.random.default_rng(seed)
    x = np.column_stack([rng.uniform([-0.7, -0.5], [0.7, 0.5], (count, 2)), np.ones(count)])
    X = x * (1.0 if depth is None else depth(x)[:, None])
    views = []
    for Y in (X, X @ R.T + t):
        pixels = factor * Y[:, :2] / Y[:, 2:] + rng.normal(0, NOISE, (count, 2))
        views.append(np.column_stack([pixels, np.ones(count)]))
    return tuple(view / np.linalg.norm(view, axis=1, keepdims=True) for view in views)


def wall(x):
    return 1 / (x @ [0.2, 0.1, 0.8])


@pytest.mark.parametrize("factor", [0.92, 0.97, 1.0, 1.04, 1.08])
@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_a_turning_camera_leaves_the_noise_and_tells_its_focal_length(factor, outliers):
    m, n = matches(TURN, np.zeros(3), factor)
    lost = int(outliers * len(n))
    n[:lost] = matches(TURN, np.zeros(3), seed=9, count=lost)[1] if lost else n[:lost]
    found = turning_camera(m, n, NOISE)
    assert found.focal_factor == pytest.approx(factor, abs=0.015)
    # The bearings' own noise is less than that of the pixels off the axis; outliers raise the median.
    assert 0.6 * NOISE < found.residual_rad < (1.8 if lost else 1.1) * NOISE
    assert found.stated_residual_rad >= found.residual_rad


@pytest.mark.parametrize("seed", range(3))
def test_a_translation_before_a_wall_leaves_more(seed):
    t = 0.1 * np.random.default_rng(seed).normal(size=3)
    m, n = matches(TURN, t, depth=wall, seed=seed)
    found = turning_camera(m, n, NOISE)
    assert found.residual_rad > 3 * NOISE
    assert suspected_focal_factor(found, 1.5 * NOISE) is None


def test_a_wrong_focal_length_is_suspected_and_a_right_one_is_not():
    for factor in (0.94, 1.06):
        found = turning_camera(*matches(TURN, np.zeros(3), factor), NOISE)
        assert suspected_focal_factor(found, 1.5 * NOISE) == pytest.approx(factor, abs=0.015)
    for seed in range(5):
        found = turning_camera(*matches(TURN, np.zeros(3), seed=seed), NOISE)
        assert suspected_focal_factor(found, 1.5 * NOISE) is None


def test_a_camera_that_stands_still_says_nothing_of_its_focal_length():
    found = turning_camera(*matches(np.eye(3), np.zeros(3), 1.08), NOISE)
    assert suspected_focal_factor(found, 1.5 * NOISE) is None


def test_a_suspicion_needs_all_of_its_grounds():
    sure = TurningCamera(1.05, 1.0, 2.0, matches=400, gain=100.0, gain_z=8.0)
    assert suspected_focal_factor(sure, 1.5) == 1.05
    assert suspected_focal_factor(replace(sure, focal_factor=0.98), 1.5) == 0.98
    for reason, weak in {
        "it does not explain the matches": replace(sure, residual_rad=1.6),
        "the stated one explains them as well": replace(sure, gain=10.0),
        "one region of the view speaks for it": replace(sure, gain_z=2.0),
        "it is near enough": replace(sure, focal_factor=1.01),
        "it is the last one that was tried": replace(sure, focal_factor=1.1),
    }.items():
        assert suspected_focal_factor(weak, 1.5) is None, reason


def test_the_fewer_the_matches_the_more_a_residual_may_exceed_its_expectation():
    """Over many draws the median length of Gaussian errors stays below the factor, and comes near it."""
    rng = np.random.default_rng(0)
    for count in (50, 800):
        lengths = np.linalg.norm(rng.normal(size=(2000, count, 2)), axis=2)
        medians = np.median(lengths, axis=1) / np.sqrt(2 * np.log(2))
        limit = TurningCamera(1.0, 1.0, 1.0, count, 0.0, 0.0).chance_factor
        assert 1 + 0.7 * (limit - 1) < medians.max() < 1 + 1.3 * (limit - 1)
