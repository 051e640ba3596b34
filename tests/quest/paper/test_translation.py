"""Translation, depths and epipolar quantities obey ``u R m + t = v n``."""

import numpy as np
import pytest

from quest.geometry.epipolar import sampson_error
from quest.geometry.quaternion import matrix_from_quaternion
from quest.paper.printed import translation_and_depths_printed
from quest.paper.translation import translation_and_depths


def two_views(seed: int, points: int = 8, baseline: float = 1.0):
    """Points in a shell all around camera 1, so that many rays are beyond 90 degrees from the axis."""
    rng = np.random.default_rng(seed)
    m = rng.normal(size=(points, 3))
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    u = rng.uniform(3, 6, points)
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    t = rng.normal(size=3)
    t *= baseline / np.linalg.norm(t) if baseline else 0.0
    X = (u[:, None] * m) @ matrix_from_quaternion(q).T + t
    v = np.linalg.norm(X, axis=1)
    return q, t, m, X / v[:, None], u, v


@pytest.mark.parametrize("seed", range(5))
def test_exact_matches_give_translation_and_depths_in_one_scale(seed: int):
    q, t, m, n, u, v = two_views(seed)
    t_, u_, v_ = translation_and_depths(q, m, n)
    assert t_ == pytest.approx(t, abs=1e-10)
    assert u_ == pytest.approx(u, abs=1e-8)
    assert v_ == pytest.approx(v, abs=1e-8)


@pytest.mark.parametrize("baseline", [0.05, 0.3])
def test_under_noise_the_direction_is_more_accurate_than_that_of_the_null_vector(baseline: float):
    errors = {translation_and_depths: [], translation_and_depths_printed: []}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        q, t = np.array([1.0, *rng.uniform(-0.2, 0.2, 3)]), rng.normal(size=3)
        q, t = q / np.linalg.norm(q), t / np.linalg.norm(t)
        X = rng.uniform([-1.2, -0.9, 3], [1.2, 0.9, 6], (60, 3))
        # 2 px at a focal length of 800 px, in both views.
        noisy = [
            Y / Y[:, 2:] + np.column_stack([rng.normal(size=(60, 2)) / 400, np.zeros(60)])
            for Y in (X, X @ matrix_from_quaternion(q).T + 4.5 * baseline * t)
        ]
        for solve, found in errors.items():
            direction = solve(q, *noisy)[0]
            found.append(np.arccos(min(1.0, abs(direction @ t) / np.linalg.norm(direction))))
    ours, printed = (np.mean(found) for found in errors.values())
    assert ours < printed


def test_many_rotations_equal_one_by_one_and_nan_gives_nan():
    q, _, m, n, _, _ = two_views(0)
    other = np.roll(q, 1)
    together = translation_and_depths(np.stack([q, [np.nan] * 4, other]), m, n)
    for alone, row in ((q, 0), (other, 2)):
        for a, b in zip(translation_and_depths(alone, m, n), together, strict=True):
            assert b[row] == pytest.approx(a)
    assert all(np.isnan(a[1]).all() for a in together)


@pytest.mark.parametrize(
    ("q", "m", "message"),
    [
        (np.ones(3), np.ones((6, 3)), r"\(4,\) or \(K, 4\)"),
        (np.ones(4), np.ones((1, 3)), "at least 2"),
        (np.zeros(4), np.ones((6, 3)), "q is zero"),
        (np.array([1, np.inf, 0, 0]), np.ones((6, 3)), "infinite"),
    ],
)
def test_wrong_arguments_are_named(q, m, message: str):
    with pytest.raises(ValueError, match=message):
        translation_and_depths(q, m, m)


def test_the_sampson_error_is_the_angle_off_the_epipolar_plane():
    q, t, m, n, _, _ = two_views(3)
    R, angle = matrix_from_quaternion(q), 1e-5
    normal = np.cross(t, n)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    moved = n + angle * normal
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    error = sampson_error(R, t, m, moved)
    # A change of n alone corrects the error by the angle. Shared between the views, the weight of a view is the
    # gradient of n . E m, the sine of the other view's distance from its epipole.
    sine_n = np.linalg.norm(np.cross(t, n), axis=1)
    sine_m = np.linalg.norm(np.cross(R.T @ t, m), axis=1)
    assert np.abs(error) == pytest.approx(angle * sine_m / np.hypot(sine_n, sine_m), rel=1e-3)


def test_the_sampson_error_is_symmetric_in_the_views_and_independent_of_the_length_of_t():
    q, t, m, n, _, _ = two_views(4)
    R = matrix_from_quaternion(q)
    m = m + 1e-3 * np.random.default_rng(0).normal(size=m.shape)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    there, back = sampson_error(R, 7 * t, m, n), sampson_error(R.T, -R.T @ t, n, m)
    assert np.abs(there) == pytest.approx(np.abs(back))
    assert np.abs(there).min() > 0
