"""Laws of the stated risk: more views lower it, and motions that explain the tracks as well raise it."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import hypotheses_of, pair_and_further, point_source, pose_errors_deg, true_motion
from make_window import hypotheses_of_scene as hypotheses

from quest.robust.spatial_blocks import regions_of
from slam_init.config import AcceptanceConfig
from slam_init.window.levels import PRINCIPAL_SIGMA
from slam_init.window.risk import risk_of
from slam_init.window.state import Priors

MAX_RISK = AcceptanceConfig().max_risk


@pytest.fixture(scope="module")
def undecided():
    """A plane in two views: the second motion explains them as well."""
    return hypotheses("wall", 0, 2, baseline=0.3)


@pytest.fixture(scope="module")
def clear():
    """A room in six views."""
    return hypotheses("room", 0, 6)


def test_views_between_the_pair_lower_the_risk_of_a_room():
    few, more, most = (risk_of(hypotheses("room", 0, views, baseline=0.1, points=150)) for views in (3, 6, 12))
    assert few.total >= more.total >= most.total
    assert few.directions.sigma_deg > most.directions.sigma_deg
    assert few.directions.rotation_sigma_deg > most.directions.rotation_sigma_deg
    assert most.total < MAX_RISK


def test_a_single_motion_has_no_competing_motion(undecided, clear):
    assert len(clear.motions) == 1
    for single in (clear, replace(undecided, motions=undecided.motions[:1])):
        risk = risk_of(single)
        assert risk.competing == 0
        assert risk.margin is None


@pytest.mark.parametrize("seed", [0, 8])
def test_a_plane_in_two_views_has_a_competing_motion_that_is_as_probable(seed):
    """All points lie within the horizon of the second motion."""
    risk = risk_of(hypotheses("wall", seed, 2, baseline=0.3))
    assert 0.2 < risk.competing <= 0.5
    assert risk.total > 0.2
    assert not risk.margin.decides()


@pytest.mark.parametrize("seed", [3, 4])
def test_points_beyond_the_horizon_of_the_second_motion_of_a_plane_count_against_it(seed):
    found = hypotheses("wall", seed, 2, baseline=0.3)
    best, second = found.motions
    truth = true_motion(point_source("wall", seed, baseline=0.3), 0, 11)
    assert pose_errors_deg(best.cam2_from_cam1, truth)[1] < 2
    rays = second.fit.state.rays
    beyond = (rays @ second.fit.state.plane <= 0) & (found.tracks.anchor == 0)
    assert np.median((second.fit.track_costs - best.fit.track_costs)[beyond]) > 3
    assert risk_of(found).competing < 0.01


@pytest.mark.parametrize("seed", [0, 3])
def test_further_views_decide_against_the_second_motion_of_a_plane(seed):
    risk = risk_of(hypotheses("wall", seed, 12, baseline=0.3))
    assert risk.competing < 1e-4
    assert risk.total < MAX_RISK


def with_competing_costs(found, extra):
    """The same hypotheses where the competing motion has the costs of the best motion plus those of the argument."""
    best, competing = found.motions
    costs = np.full_like(best.fit.track_costs, 1.0)
    a = replace(best, fit=replace(best.fit, track_costs=costs))
    b = replace(competing, fit=replace(competing.fit, track_costs=costs + extra))
    return replace(found, motions=(a, b))


def test_tracks_of_one_region_of_the_image_cannot_decide(undecided):
    rays = undecided.motions[0].fit.state.rays
    region = regions_of(np.arctan2(rays[:, :2], rays[:, 2:]))
    largest = np.argmax(np.bincount(region))
    risk = risk_of(with_competing_costs(undecided, 5.0 * (region == largest)))
    assert risk.competing == 0.5
    assert risk.margin.log_likelihood == pytest.approx(0, abs=1e-9)
    others = risk_of(with_competing_costs(undecided, 5.0 * (region != largest)))
    assert others.competing < 1e-9


def test_votes_that_are_as_good_as_symmetric_do_not_decide(undecided):
    """Two equivalent motions: both fits absorb noise, so the votes scatter, and their sum may be large by chance."""
    count = len(undecided.motions[0].fit.track_costs)
    scattered = 4.0 * np.where(np.arange(count) % 2, 1, -1)
    ahead = 12.0 / count
    for votes, decided in ((2 * (scattered + ahead), False), (2 * ahead * np.ones(count), True)):
        risk = risk_of(with_competing_costs(undecided, np.asarray(votes)))
        assert (risk.competing < 0.05) == decided


@pytest.mark.parametrize("sign", [1, -1])
def test_a_track_votes_by_three_nats_at_the_most(undecided, sign):
    count = len(undecided.motions[0].fit.track_costs)
    some = (np.arange(count) % 7 == 0).astype(float)
    margin = risk_of(with_competing_costs(undecided, 1e6 * sign * some)).margin
    assert 0 < sign * margin.log_likelihood <= 3 * some.sum()


def test_a_competing_motion_that_locates_fewer_views_pays_for_the_views_it_leaves_out():
    found = hypotheses("wall", 0, 4, baseline=0.3)
    best, competing = found.motions
    equal = replace(competing, fit=replace(competing.fit, track_costs=best.fit.track_costs))
    fewer = replace(equal, rows=(0, 1, 2))
    with_all, without = (risk_of(replace(found, motions=(best, one))) for one in (equal, fewer))
    assert with_all.competing == 0.5
    assert without.competing < 1e-6


def test_the_direction_of_the_pair_is_the_first_of_the_views_and_that_of_a_near_view_is_less_certain():
    found = hypotheses("room", 2, 12, baseline=0.1, points=100)
    risk = risk_of(found)
    assert len(risk.directions.of_views) == len(found.motions[0].rows) - 1
    assert risk.directions.of_views[0] == risk.direction
    nearest = found.motions[0].frames.index(1) - 1
    assert risk.directions.of_views[nearest] > 10 * risk.direction


def test_the_stated_size_of_the_error_fields_grows_with_that_of_the_tracks():
    none, some, large = (risk_of(hypotheses("room", 0, 8, correlated_px=px)).correlated_px for px in (0, 0.5, 1.5))
    assert none < 0.12
    assert none < some < large
    assert large > 0.5


def test_above_a_bound_the_term_of_the_competing_motions_is_a_lower_one():
    """Fits with fields of correlated errors only raise it, so that the decision is the same."""
    for seed in range(3):
        found = hypotheses("nadir", seed, 6, baseline=0.06)
        whole, bounded = risk_of(found), risk_of(found, 0.005)
        assert bounded.competing <= whole.competing
        assert (bounded.total <= 0.005) == (whole.total <= 0.005)
        if bounded.total <= 0.005:
            assert bounded.total == whole.total


def test_a_turn_about_the_optical_axis_over_flat_ground_leaves_the_direction_known():
    """There the image moves by the error of the principal point; a calibration knows it well enough."""
    source = point_source("nadir-turn", 0, baseline=0.1)
    priors = Priors(0.03, principal_sigma_px=PRINCIPAL_SIGMA * source.camera.width)
    risk = risk_of(hypotheses_of(source.camera, pair_and_further(list(source.observations()), 12), priors))
    assert risk.direction < 0.005
