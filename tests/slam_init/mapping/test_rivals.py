"""Laws of the comparison of candidate maps: which one is better, by how much, and when two maps are the same."""

from dataclasses import replace

import numpy as np
import pytest
from make_candidates import (
    ALL,
    bent,
    build,
    general_candidate,
    general_views,
    planar_candidates,
)
from make_scene import CAMERA, hypothesis

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.problem import BundleFailure
from slam_init.mapping.rivals import difference_of_maps_deg, explained_at_most, margin, margin_of, rank, same_map
from slam_init.types.pose import Pose


@pytest.fixture(scope="module")
def general():
    return general_candidate()


def test_further_views_decide_between_the_two_maps_of_a_plane():
    true, twin = planar_candidates(views=5)
    assert not same_map(true, twin)
    assert rank(CAMERA, [twin, true])[0] is true
    assert margin(CAMERA, true, twin).decides()
    assert not margin(CAMERA, twin, true).decides()


def test_two_views_of_a_plane_decide_nothing():
    true, twin = planar_candidates(views=2)
    assert np.isnan(true.agreement)
    assert not margin(CAMERA, true, twin).decides()
    assert not margin(CAMERA, twin, true).decides()


def test_the_sign_of_the_margin_changes_with_the_order():
    true, twin = planar_candidates(views=4)
    there, back = margin(CAMERA, true, twin), margin(CAMERA, twin, true)
    assert there.log_likelihood > 0 > back.log_likelihood
    assert there.z > 0 > back.z


def test_a_map_is_the_same_as_itself_and_has_no_margin_over_itself(general):
    assert same_map(general, general)
    nothing = margin(CAMERA, general, general)
    assert nothing.log_likelihood == 0
    assert not nothing.decides()


def test_two_nearby_hypotheses_end_in_the_same_map(general):
    nearby = Pose(rotation_from_vector(np.array([0, 2e-4, 0])) @ general.hypothesis.R, general.hypothesis.t)
    assert same_map(general, build(general_views(), hypothesis(nearby, ALL)))


def test_a_failed_map_equals_no_other_map_and_is_ranked_last(general):
    failed = replace(general, bundle=BundleFailure("for this test"))
    assert not same_map(general, failed)
    assert not same_map(failed, failed)
    assert rank(CAMERA, [failed, general]) == [general, failed]
    assert not margin(CAMERA, failed, general).decides()


def test_maps_differ_by_the_angles_between_their_baselines(general):
    rotation_deg, direction_deg = difference_of_maps_deg(general, bent(general, 5))
    assert rotation_deg == pytest.approx(0, abs=1e-6)
    assert 1 < direction_deg <= 5 + 1e-9
    assert difference_of_maps_deg(general, general) == pytest.approx((0, 0), abs=1e-5)
    failed = replace(general, bundle=BundleFailure("for this test"))
    assert difference_of_maps_deg(general, failed) == (np.inf, np.inf)


@pytest.mark.parametrize("freedom", [1, 5, 9, 21])
def test_hardly_any_correct_track_exceeds_the_largest_explained_cost(freedom):
    costs = np.random.default_rng(0).chisquare(freedom, 100_000)
    limit = explained_at_most(np.array(freedom))
    assert np.mean(costs > limit) < 0.005
    assert freedom < limit < explained_at_most(np.array(freedom + 1))


def test_a_track_without_freedom_has_no_cost():
    assert explained_at_most(np.array([0])) == 0


def test_equal_votes_of_neighbours_count_as_one_vote():
    rng = np.random.default_rng(0)
    where = rng.uniform(0, 1, (480, 2))
    single = 0.5 + rng.normal(size=480)
    # As many votes, but all tracks of a region have the same one.
    region = (where * (8, 6)).astype(int) @ (6, 1)
    by_region = (0.5 + rng.normal(size=48))[region]
    assert margin_of(single, where).z > 6
    assert margin_of(by_region, where).z < 0.6 * by_region.sum() / np.sqrt(np.sum(by_region**2))
    assert margin_of(-by_region, where).z == pytest.approx(-margin_of(by_region, where).z)
    assert margin_of(np.zeros(480), where).z == 0
