"""Views with known gravity, many pairs on threads, and pixels with distortion."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, R_TRUE, T_TRUE, box, is_true, plane, random_rays, views
from make_views import unit

import quest
from quest.geometry.quaternion import rotation_from_vector
from quest.gravity import upright_poses

GRAVITY1 = unit(np.array([0.1, 1.0, -0.2]))
GRAVITY2 = R_TRUE @ GRAVITY1


def turned(seed: int):
    """A rotation about the third axis, a direction, and three exact matches of it."""
    rng = np.random.default_rng(seed)
    R, t = rotation_from_vector([0, 0, rng.uniform(-np.pi, np.pi)]), unit(rng.normal(size=3))
    X = rng.normal(size=(3, 3)) + 3 * unit(rng.normal(size=3))
    return R, t, unit(X), unit(X @ R.T + t)


def test_three_exact_matches_have_the_true_pose_among_their_solutions():
    for seed in range(200):
        R, t, m, n = turned(seed)
        found_R, found_t = upright_poses(m[None], n[None])
        assert len(found_R) <= 4
        off = np.abs(found_R - R).max(axis=(1, 2)) + 1 - np.abs(found_t @ t)
        assert off.min() < 1e-6, seed
        for R_k, t_k in zip(found_R, found_t, strict=True):
            assert np.abs(np.cross(m @ R_k.T, n) @ t_k).max() < 0.1, seed


@pytest.mark.parametrize(("scene", "kind"), [(box, "general"), (plane, "planar")], ids=["general", "planar"])
@pytest.mark.parametrize("outliers", [0.0, 0.7])
def test_a_motion_with_known_gravity_is_found(scene, kind, outliers):
    m, n = views(scene(0), noise_rad=NOISE_RAD, outliers=outliers)
    found = quest.estimate_upright_pose(m, n, GRAVITY1, GRAVITY2)
    assert found.kind == kind
    hypotheses = (found, *found.alternatives)
    assert any(is_true(one, rotation_deg=0.5, direction_deg=3) for one in hypotheses)
    assert np.isfinite(found.covariance).all()


def test_an_error_of_gravity_is_not_in_the_result():
    m, n = views(box(0), noise_rad=NOISE_RAD, outliers=0.3)
    off = rotation_from_vector([0.01, 0.0, 0.01]) @ GRAVITY2
    exact, found = (quest.estimate_upright_pose(m, n, GRAVITY1, gravity) for gravity in (GRAVITY2, off))
    assert is_true(found, exact.R, exact.t, rotation_deg=0.05, direction_deg=0.3)


def test_a_turn_random_matches_and_few_matches_have_no_motion_with_known_gravity():
    turn = quest.estimate_upright_pose(*views(box(0), t=NO_TRANSLATION, noise_rad=NOISE_RAD), GRAVITY1, GRAVITY2)
    assert turn.kind == "rotation"
    rng = np.random.default_rng(0)
    assert not quest.estimate_upright_pose(random_rays(rng, 100), random_rays(rng, 100), GRAVITY1, GRAVITY2)
    assert not quest.estimate_upright_pose(*views(box(0)[:8]), GRAVITY1, GRAVITY2)
    with pytest.raises(quest.InputError):
        quest.estimate_upright_pose(*views(box(0)), GRAVITY1, np.zeros(3))


def test_many_pairs_have_the_results_of_one_on_any_number_of_threads():
    pairs = [views(box(seed), noise_rad=NOISE_RAD, outliers=0.4, seed=seed) for seed in range(6)]
    alone = [quest.estimate_relative_pose(*pair, seed=3) for pair in pairs]
    for threads in (1, 3):
        found = quest.estimate_relative_poses(iter(pairs), threads=threads, seed=3)
        assert all((a.R == b.R).all() and (a.t == b.t).all() for a, b in zip(alone, found, strict=True))
    assert quest.estimate_relative_poses([]) == []
    with pytest.raises(quest.InputError):
        quest.estimate_relative_poses(pairs, threads=0)


def distorted(rays, K, coefficients):
    """Pixels of rays in the model of OpenCV."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = (rays[:, :2] / rays[:, 2:]).T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([u, v, np.ones(len(u))]) @ K[:2].T


def test_the_distortion_of_pixels_is_taken_out():
    K, coefficients = np.array([[500.0, 0, 320], [0, 490, 240], [0, 0, 1]]), (-0.25, 0.08, 1e-3, -2e-3, 0.01)
    m, n = views(box(0), noise_rad=1e-6)
    pixels = distorted(m, K, coefficients), distorted(n, K, coefficients)
    found = quest.estimate_relative_pose_px(*pixels, K, distortion1=coefficients)
    assert is_true(found, R_TRUE, T_TRUE, rotation_deg=1e-3, direction_deg=0.01)
    with pytest.raises(quest.InputError, match="distortion"):
        quest.estimate_relative_pose_px(*pixels, K, distortion1=(1.0, 2.0))
    with pytest.raises(quest.InputError, match="outside"):
        quest.estimate_relative_pose_px(*pixels, K, distortion1=(-2.0, 0.0, 0.0, 0.0))
