"""Laws of the lens by all frames of a stretch: a strong one is found, and a straight motion determines no lens."""

from dataclasses import replace

import numpy as np
import pytest

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.lens_fit import Matches, fit_lens
from slam_init.calibration.files import prior_camera
from slam_init.types.camera import Camera

TRUE = Camera("radtan", 640, 480, 400.0, 400.0, 322.0, 238.0, (-0.3, 0.1, 0.0, 0.0))
START = Camera("radtan", 640, 480, 440.0, 440.0, 319.5, 239.5, (-0.2, 0.0, 0.0, 0.0))
PRIOR = prior_camera((640, 480))


def matches(turning, forward, *, points=250, seed=0):
    """Points seen by eight views of a camera that moves and turns; the start has the true poses and points."""
    rng = np.random.default_rng(seed)
    world = rng.uniform((-4, -3, 4), (4, 3, 12), (points, 3))
    steps = np.linspace(0, 1, 8)
    R = np.array([rotation_from_vector(turning * np.array([0.2 * s, 0.4 * s, 0.1 * s * s])) for s in steps])
    centres = np.outer(steps, (0, 0, 2) if forward else (1.5, 0.3, 0.4))
    t = -np.einsum("kij,kj->ki", R, centres)
    views, tracks, pixels = [], [], []
    for k in range(8):
        seen = TRUE.project(world @ R[k].T + t[k])
        inside = np.isfinite(seen).all(axis=1) & (seen > 0).all(axis=1) & (seen < (640, 480)).all(axis=1)
        views.append(np.full(inside.sum(), k))
        tracks.append(np.flatnonzero(inside))
        pixels.append(seen[inside] + 0.2 * rng.normal(size=(inside.sum(), 2)))
    X = np.column_stack([world, np.ones(points)])
    X /= np.linalg.norm(X, axis=1)[:, None]
    return Matches(np.concatenate(views), np.concatenate(tracks), np.concatenate(pixels), R, t, X)


def test_a_strong_lens_is_found_from_a_start_that_is_off_by_a_tenth():
    found = fit_lens(matches(1.0, forward=False), START, PRIOR)
    assert found.focal_px == pytest.approx(TRUE.fx, rel=0.01)
    assert (found.k1, found.k2) == pytest.approx(TRUE.distortion[:2], abs=0.02)
    assert abs(found.focal_px / TRUE.fx - 1) < 2 * found.focal_sigma < 0.1


def test_a_camera_that_moves_straight_ahead_determines_no_focal_length():
    found = fit_lens(matches(0.0, forward=True), replace(START, distortion=TRUE.distortion), PRIOR)
    assert found.focal_sigma > 0.15


def test_wrong_matches_do_not_move_the_lens():
    one = matches(1.0, forward=False)
    wrong = np.random.default_rng(2).random(len(one.pixels)) < 0.2
    pixels = np.where(
        wrong[:, None], np.random.default_rng(3).uniform((0, 0), (640, 480), one.pixels.shape), one.pixels
    )
    found = fit_lens(one._replace(pixels=pixels), START, PRIOR)
    assert found.focal_px == pytest.approx(TRUE.fx, rel=0.02)
    assert 0.7 < found.inliers < 0.85
