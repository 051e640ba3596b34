"""Joins of maps: a moved copy gives the motion, another world gives none, and two places of one look give none."""

from dataclasses import replace

import numpy as np
import pytest
from make_place import make_place, moved, rays_to

from quest.geometry.quaternion import rotation_from_vector
from slam_init import NoJoin, Similarity, join
from slam_init.types.place import Place
from slam_init.types.unit_error import UnitError

MOTION = Similarity(2.5, rotation_from_vector(np.array([0.3, 1.0, 0.2])), np.array([1.0, 2.0, 3.0]))


def rearranged(place, points):
    """The same descriptors on other points, which the same views see."""
    rays = rays_to(place.views, place.observation_views, points[place.observation_points])
    return replace(place, points=points, observation_bearings=rays)


def test_a_moved_copy_gives_the_similarity_that_moved_it():
    place = make_place()
    found = join(moved(place, MOTION), place)
    assert found and found.reason is None and found.inliers == found.matches == 120
    assert found.first_from_second.s == pytest.approx(MOTION.s, rel=1e-8)
    np.testing.assert_allclose(found.first_from_second.R, MOTION.R, atol=1e-8)
    np.testing.assert_allclose(found.first_from_second.t, MOTION.t, atol=1e-7)
    assert found.risk < 1e-50 and "scale       2.5 " in str(found)


def test_the_other_way_round_gives_the_inverse():
    place = make_place()
    there, back = join(moved(place, MOTION), place).first_from_second, MOTION.inverse()
    assert join(place, moved(place, MOTION)).first_from_second.s == pytest.approx(back.s, rel=1e-8)
    X = place.points
    np.testing.assert_allclose(there.inverse().apply(there.apply(X)), X, atol=1e-9)
    np.testing.assert_allclose(back.apply(MOTION.apply(X)), X, atol=1e-9)


def test_the_error_of_the_scale_is_as_large_as_stated():
    """With noise of a pixel or two in all rays of both maps, whose points are those that the rays were drawn from."""
    errors = []
    for seed in range(5):
        place, again = make_place(seed, noise_rad=0.002), make_place(seed, noise_rad=0.002)
        rays = again.observation_bearings + 0.002 * np.random.default_rng(99 + seed).normal(size=(480, 3))
        again = replace(again, observation_bearings=rays / np.linalg.norm(rays, axis=1, keepdims=True))
        found = join(moved(place, MOTION), again)
        errors.append((found.first_from_second.s / MOTION.s - 1) / found.scale_sigma)
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 3


@pytest.mark.parametrize("seed", range(3))
def test_points_that_lie_elsewhere_are_not_joined_though_they_look_alike(seed):
    place = make_place(seed)
    other = rearranged(place, np.random.default_rng(100 + seed).permutation(place.points))
    found = join(place, other)
    assert not found and found.reason is NoJoin.NO_COMMON_PLACE and found.matches == 120
    assert found.risk > 1e-4 and "chance" in str(found)


def test_points_that_look_otherwise_are_not_joined():
    found = join(make_place(0), make_place(1))
    assert not found and found.reason is NoJoin.NO_COMMON_PLACE and found.inliers == 0


def test_a_third_of_right_matches_is_enough():
    place = make_place()
    points = place.points.copy()
    points[40:] = np.random.default_rng(3).permutation(points[40:])
    found = join(moved(place, MOTION), rearranged(place, points))
    assert found.first_from_second.s == pytest.approx(MOTION.s, rel=1e-3) and found.inliers < 60


def test_a_pattern_that_fits_at_two_places_is_ambiguous():
    place = make_place()
    points = place.points.copy()
    points[60:] += [0.8, 0.0, 0.0]
    found = join(place, rearranged(place, points))
    assert not found and found.reason is NoJoin.AMBIGUOUS_PLACE


def test_a_scale_that_the_depths_of_a_map_leave_open_is_refused():
    place = make_place()
    known = join(replace(place, unit_error=UnitError(0.015)), replace(place, unit_error=UnitError(0.02)))
    assert known.scale_sigma == pytest.approx(0.025, rel=1e-3)
    found = join(place, replace(place, unit_error=UnitError(0.2)))
    assert not found and found.reason is NoJoin.SCALE_OPEN and found.scale_sigma > 0.19


def test_the_error_of_a_lens_that_both_maps_have_in_common_cancels():
    by_lens = np.array([0.08, 0.0, 0.01, 0.05])
    place = replace(make_place(), unit_error=UnitError(0.01, by_lens), lens=(500.0, 500.0, 320.0, 240.0))
    alike = join(place, place)
    assert alike and alike.scale_sigma == pytest.approx(0.01 * np.sqrt(2), rel=1e-2)
    other = join(place, replace(place, lens=(510.0, 510.0, 320.0, 240.0)))
    assert not other and other.reason is NoJoin.SCALE_OPEN
    assert other.scale_sigma == pytest.approx(np.sqrt(2) * place.unit_error.sigma, rel=1e-2)
    unknown = replace(place, lens=())
    assert not join(unknown, unknown)


def test_the_same_seed_gives_the_same_join():
    place = make_place(noise_rad=0.002)
    first, second = (join(moved(place, MOTION), place, seed=4) for _ in range(2))
    assert first.first_from_second.s == second.first_from_second.s and first.scale_sigma == second.scale_sigma


def test_a_place_without_points_is_not_joined():
    assert join(Place.empty(), make_place()).reason is NoJoin.NO_COMMON_PLACE
