"""Laws of the stated risk: its terms add up, more views lower it, and a rotation-only camera never has a small one."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import hypotheses_of, pair_and_further, point_source, pose_errors_deg, true_motion

from quest.geometry.quaternion import rotation_from_vector
from quest.robust.spatial_blocks import regions_of
from sequences_synth.points import PointOptions, make_points
from slam_init.config import AcceptanceConfig
from slam_init.datasets.points import PointSource
from slam_init.window import rival as rival_module
from slam_init.window.levels import UNDECIDED
from slam_init.window.risk import confirmed, risk_of
from slam_init.window.rotation_term import rotation_probability
from slam_init.window.state import Priors
from slam_init.window.uncertainty import expand

PRIORS = Priors(focal_sigma=0.03)
MAX_RISK = AcceptanceConfig().max_risk


def hypotheses(scene, seed, views, last=None, priors=PRIORS, **options):
    """The hypotheses of the first and the last frame, and of evenly spaced frames between."""
    source = point_source(scene, seed, **options)
    observations = list(source.observations())
    picks = np.linspace(0, len(observations) - 1 if last is None else last, views).round().astype(int)
    return hypotheses_of(source.camera, pair_and_further([observations[k] for k in picks], views), priors)


@pytest.fixture(scope="module")
def undecided():
    """A plane in two views: the twin explains them as well."""
    return hypotheses("wall", 0, 2, baseline=0.3)


@pytest.fixture(scope="module")
def clear():
    """A room in six views."""
    return hypotheses("room", 0, 6)


@pytest.mark.parametrize(
    ("scene", "views"), [("room", 2), ("room", 3), ("room", 5), ("wall", 2), ("wall", 5), ("desk", 4)]
)
def test_the_terms_add_up(scene, views):
    for seed in range(2):
        risk = risk_of(hypotheses(scene, seed, views, baseline=0.08, points=150))
        terms = (risk.direction, risk.rival, risk.rotation, risk.moving, risk.floor)
        assert all(0 <= term <= 1 for term in terms)
        assert risk.total == pytest.approx(min(1.0, sum(terms)))
        assert risk.total >= risk.floor > 0


@pytest.mark.parametrize("seed", range(3))
def test_views_between_the_pair_lower_the_risk_of_a_room(seed):
    few, more, most = (risk_of(hypotheses("room", seed, views, baseline=0.1, points=150)) for views in (3, 6, 12))
    assert few.total >= more.total >= most.total
    assert few.direction_sigma_deg > most.direction_sigma_deg
    assert few.rotation_sigma_deg > most.rotation_sigma_deg
    assert most.total < MAX_RISK


@pytest.mark.parametrize("seed", range(3))
def test_a_longer_window_lowers_the_risk_of_a_room(seed):
    few, most = (risk_of(hypotheses("room", seed, last + 1, last, baseline=0.1, points=150)) for last in (2, 11))
    assert few.total >= most.total
    assert few.direction_sigma_deg > most.direction_sigma_deg


def test_a_single_motion_has_no_rival(undecided, clear):
    assert len(clear.motions) == 1
    for single in (clear, replace(undecided, motions=undecided.motions[:1])):
        risk = risk_of(single)
        assert risk.rival == 0
        assert risk.margin is None


@pytest.mark.parametrize("seed", [0, 5, 8, 10, 11])
def test_a_plane_in_two_views_has_a_rival_that_is_as_probable(seed):
    """All points lie within the horizon of the twin."""
    risk = risk_of(hypotheses("wall", seed, 2, baseline=0.3))
    assert 0.2 < risk.rival <= 0.5
    assert risk.total > 0.2
    assert not risk.margin.decides()


@pytest.mark.parametrize("seed", [3, 4, 9])
def test_points_beyond_the_horizon_of_the_twin_of_a_plane_count_against_it(seed):
    found = hypotheses("wall", seed, 2, baseline=0.3)
    best, twin = found.motions
    truth = true_motion(point_source("wall", seed, baseline=0.3), 0, 11)
    assert pose_errors_deg(best.cam2_from_cam1, truth)[1] < 2
    rays = twin.fit.state.rays
    beyond = (rays @ twin.fit.state.plane <= 0) & (found.tracks.anchor == 0)
    assert np.median((twin.fit.track_costs - best.fit.track_costs)[beyond]) > 3
    assert risk_of(found).rival < 0.01


@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_further_views_decide_against_the_twin_of_a_plane(seed):
    risk = risk_of(hypotheses("wall", seed, 12, baseline=0.3))
    assert risk.rival < 1e-4
    assert risk.total < MAX_RISK


def with_rival_costs(found, extra):
    """The same hypotheses where the rival has the costs of the best motion plus those of the argument."""
    best, rival = found.motions
    costs = np.full_like(best.fit.track_costs, 1.0)
    a = replace(best, fit=replace(best.fit, track_costs=costs))
    b = replace(rival, fit=replace(rival.fit, track_costs=costs + extra))
    return replace(found, motions=(a, b))


def test_tracks_of_one_region_of_the_image_cannot_decide(undecided):
    rays = undecided.motions[0].fit.state.rays
    region = regions_of(np.arctan2(rays[:, :2], rays[:, 2:]))
    largest = np.argmax(np.bincount(region))
    risk = risk_of(with_rival_costs(undecided, 5.0 * (region == largest)))
    assert risk.rival == 0.5
    assert risk.margin.log_likelihood == pytest.approx(0, abs=1e-9)
    others = risk_of(with_rival_costs(undecided, 5.0 * (region != largest)))
    assert others.rival < 1e-9


def test_votes_that_are_as_good_as_symmetric_do_not_decide(undecided):
    """Two exact twins: both fits absorb noise, so the votes scatter, and their sum may be large by chance."""
    count = len(undecided.motions[0].fit.track_costs)
    scattered = 4.0 * np.where(np.arange(count) % 2, 1, -1)
    ahead = 12.0 / count
    for votes, decided in ((2 * (scattered + ahead), False), (2 * ahead * np.ones(count), True)):
        risk = risk_of(with_rival_costs(undecided, np.asarray(votes)))
        assert (risk.rival < 0.05) == decided


@pytest.mark.parametrize("sign", [1, -1])
def test_a_track_votes_by_three_nats_at_the_most(undecided, sign):
    count = len(undecided.motions[0].fit.track_costs)
    some = (np.arange(count) % 7 == 0).astype(float)
    margin = risk_of(with_rival_costs(undecided, 1e6 * sign * some)).margin
    assert 0 < sign * margin.log_likelihood <= 3 * some.sum()


def test_tracks_that_neither_motion_explains_do_not_vote(undecided):
    best, rival = undecided.motions
    count = len(best.fit.track_costs)
    wrong = np.arange(count) % 7 == 0
    rng = np.random.default_rng(0)
    motions = tuple(
        replace(m, fit=replace(m.fit, track_costs=np.where(wrong, rng.uniform(20, 90, count), 1.0)))
        for m in (best, rival)
    )
    assert risk_of(replace(undecided, motions=motions)).margin.log_likelihood == 0


def test_a_rival_that_locates_fewer_views_pays_for_the_views_it_leaves_out():
    found = hypotheses("wall", 0, 4, baseline=0.3)
    best, rival = found.motions
    equal = replace(rival, fit=replace(rival.fit, track_costs=best.fit.track_costs))
    fewer = replace(equal, rows=(0, 1, 2))
    with_all, without = (risk_of(replace(found, motions=(best, one))) for one in (equal, fewer))
    assert with_all.rival == 0.5
    assert without.rival < 1e-6


def test_the_rotation_term_falls_with_the_gain_over_the_rotation_only_camera(clear):
    cost, expanded = clear.motions[0].fit.cost, expand(clear, clear.motions[0])
    gains, probabilities, _ = zip(
        *(
            rotation_probability(replace(clear, rotation_only=replace(clear.rotation_only, cost=cost + gain)), expanded)
            for gain in (0.0, 400.0, 800.0, 1600.0, 4000.0)
        ),
        strict=True,
    )
    assert probabilities[0] > 0.999
    assert probabilities[-1] < 1e-6
    assert (np.diff(probabilities) <= 0).all()
    np.testing.assert_allclose(gains, [0, 200, 400, 800, 2000])


def test_a_gain_tells_less_where_the_image_moved_further_for_a_tracker_keeps_errors(clear):
    cost, fit = clear.motions[0].fit.cost, clear.rotation_only
    views = len(fit.state.R)

    def rotation_term(turn_deg):
        turns = np.radians(turn_deg) * np.arange(views) / (views - 1)
        R = np.array([rotation_from_vector(turn * np.array([0.0, 1.0, 0.0])) for turn in turns])
        turned = replace(fit, cost=cost + 700.0, state=replace(fit.state, R=R))
        noisy = replace(clear, tracks=clear.tracks.with_noise(0.1), rotation_only=turned)
        return rotation_probability(noisy, expand(clear, clear.motions[0]))[1]

    none, little, much, most = map(rotation_term, (0.0, 1.0, 5.0, 20.0))
    assert none <= little <= much <= most
    assert none < 1e-3
    assert most > 0.9


def turned_views(scene, seed, turn_deg, lasting_px=0.0, on_body=0.0, **options):
    """Three views, of which the later ones are turned; a tracker keeps an error of each track in both of them."""
    source, rng = point_source(scene, seed, noise_px=0.1, **options), np.random.default_rng(seed)
    views = pair_and_further(list(source.observations())[::5][:3], 3)
    ids = np.unique(np.concatenate([view.track_ids for view in views]))
    errors, moves = rng.normal(0, lasting_px, (len(ids), 2)), rng.random(len(ids)) < on_body
    nearness, turned = 10 * rng.uniform(0.5, 1.5, len(ids)), []
    for view in views:
        later = view.frame > views[0].frame
        R = rotation_from_vector(np.radians(turn_deg if later else 0.0) * np.array([0.0, 1.0, 0.0]))
        at = np.searchsorted(ids, view.track_ids)
        step = (view.frame - views[0].frame) / 5 * np.array([1.0, 0.3]) * nearness[at, None]
        pixels = source.camera.project(view.bearings @ R.T)
        pixels = pixels + later * (errors[at] + moves[at, None] * step)
        inside = np.isfinite(pixels).all(axis=1)
        bearings = source.camera.bearings(pixels)
        turned.append(replace(view.at(np.flatnonzero(inside)), pixels=pixels[inside], bearings=bearings[inside]))
    return source.camera, turned


@pytest.mark.parametrize("seed", range(3))
def test_two_views_tell_a_translation_beyond_what_a_tracker_keeps(seed):
    """With a noise of a third of these errors, chance would gain more than outliers gain at the most."""
    camera, views = turned_views("room", seed, 20.0, baseline=0.3)
    found = hypotheses_of(camera, views[:2], PRIORS)
    risk = risk_of(found)
    assert risk.lasting_in_noise
    assert rotation_probability(found, expand(found, found.motions[0]))[1] > UNDECIDED
    assert risk.rotation < 1e-3


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("views", [2, 3])
def test_bodies_before_a_turning_camera_are_no_translation_whatever_its_tracker_keeps(seed, views):
    """A third of the tracks moves with a body; the errors that the others keep gain for a translation as well."""
    camera, turned = turned_views("rotation", seed, 15.0, lasting_px=0.3, on_body=0.3)
    found = hypotheses_of(camera, turned[:views], PRIORS)
    risk = risk_of(found)
    _, again = confirmed(found, replace(risk, total=0.0), MAX_RISK)
    assert risk.rotation > 0.5
    assert again.rotation > 0.5


@pytest.mark.parametrize("seed", range(0, 8, 2))
def test_a_rotation_only_camera_of_wrong_focal_length_never_has_a_small_risk(seed):
    """Where the focal length is wrong, quest takes some rotation-only cameras for moving ones."""
    for views in (8, 10, 12):
        found = hypotheses("rotation", seed, views, views - 1, focal_error=0.05)
        if found is not None:
            assert risk_of(found).total > MAX_RISK


def test_some_rotation_only_cameras_of_wrong_focal_length_have_a_proposed_motion():
    """The law above is not empty."""
    assert hypotheses("rotation", 6, 10, 9, focal_error=0.05) is not None


def risk_with_noise(noise_px, stated_px):
    source = point_source("room", 0, noise_px=noise_px)
    views = pair_and_further(list(source.observations()), 6)
    return risk_of(hypotheses_of(source.camera, views, Priors(1e-6), stated_px))


def test_the_standard_deviations_follow_the_noise_of_the_tracks():
    a, b = risk_with_noise(0.4, 0.4), risk_with_noise(0.8, 0.8)
    # The error of the principal point does not follow the noise.
    for of in (
        lambda risk: risk.direction_sigma_deg,
        lambda risk: risk.rotation_sigma_deg,
        lambda risk: risk.depth_sigma,
    ):
        assert 1.1 < of(b) / of(a) < 2.6
    assert b.direction >= a.direction


def test_the_stated_noise_does_not_change_the_standard_deviations():
    a, b = risk_with_noise(0.5, 0.5), risk_with_noise(0.5, 1.0)
    assert b.direction_sigma_deg == pytest.approx(a.direction_sigma_deg, rel=0.05)
    assert b.depth_sigma == pytest.approx(a.depth_sigma, rel=0.05)


def test_the_direction_of_the_pair_is_the_first_of_the_views_and_that_of_a_near_view_is_less_certain():
    found = hypotheses("room", 2, 12, baseline=0.1, points=100)
    risk = risk_of(found)
    assert len(risk.direction_of_views) == len(found.motions[0].rows) - 1
    assert risk.direction_of_views[0] == risk.direction
    nearest = found.motions[0].frames.index(1) - 1
    assert risk.direction_of_views[nearest] > 10 * risk.direction


@pytest.mark.parametrize("scene", ["room", "wall"])
def test_the_relative_errors_of_the_depths_have_the_stated_size(scene):
    """The focal length is known, since that of the drawn worlds has no error."""
    ratios = []
    for seed in range(8):
        found = hypotheses(scene, seed, 8, priors=Priors(1e-6), baseline=0.2, outliers=0.0)
        truth = make_points(scene, seed, PointOptions(baseline=0.2, outliers=0.0))
        best, tracks = found.motions[0].fit.state, found.tracks
        inverse = best.inverse_distances.copy()
        if best.plane is not None:
            inverse[best.on_plane] = best.rays[best.on_plane] @ best.plane
        seen = (tracks.anchor == 0) & (inverse > 0)
        depths = truth.depths(0)[tracks.track_ids] / best.rays[:, 2]
        relative = np.linalg.norm(best.t[1]) / np.linalg.norm(true_motion(PointSource(truth), 0, 11).t)
        errors = np.log(inverse * depths * relative)[seen]
        # The median of the absolute value of a Gaussian is 0.67 standard deviations.
        ratios.append(np.median(np.abs(errors)) / 0.67 / risk_of(found).depth_sigma)
    # Depths of a plane share their errors, so one window says little.
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.7


@pytest.mark.parametrize("seed", range(3))
def test_the_stated_size_of_the_error_fields_grows_with_that_of_the_tracks(seed):
    none, some, large = (risk_of(hypotheses("room", seed, 8, field_px=field_px)).field_px for field_px in (0, 0.5, 1.5))
    assert none < 0.12
    assert none < some < large
    assert large > 0.5


def fits_with_fields(monkeypatch):
    """The numbers of steps of the fits with fields that the risk asks for, as they are made."""
    steps, real = [], rival_module.fit_window

    def noted(*arguments, **options):
        fit = real(*arguments, **options)
        steps.append(fit.iterations)
        return fit

    monkeypatch.setattr(rival_module, "fit_window", noted)
    return steps


def test_rivals_are_not_fitted_with_fields_where_the_direction_is_unknown(monkeypatch):
    steps, unknown = fits_with_fields(monkeypatch), 0
    for seed in range(6):
        found = hypotheses("wall", seed, 4, baseline=0.01)
        steps.clear()
        if found is not None and risk_of(found).direction > 0.2:
            unknown += 1
            assert not steps
    assert unknown


def test_a_motion_is_fitted_once_with_the_fields_of_a_scale(monkeypatch):
    steps = fits_with_fields(monkeypatch)
    found = next(one for one in (hypotheses("wall", seed, 3, baseline=0.1) for seed in range(4)) if one is not None)
    best, rival = found.motions[:2]
    best_and_rival = replace(found, motions=(best, rival))
    twice = replace(found, motions=(best, rival, rival))
    once = risk_of(best_and_rival)
    assert steps
    steps.clear()
    again = risk_of(twice)
    assert not steps
    assert again.rival == pytest.approx(min(2 * once.rival, 1.0))


def test_above_a_bound_the_term_of_the_rivals_is_a_lower_one():
    """Fits with error fields only raise it, so that the decision is the same."""
    for seed in range(3):
        found = hypotheses("nadir", seed, 6, baseline=0.06)
        whole, bounded = risk_of(found), risk_of(found, 0.005)
        assert bounded.rival <= whole.rival
        assert (bounded.total <= 0.005) == (whole.total <= 0.005)
        if bounded.total <= 0.005:
            assert bounded.total == whole.total


@pytest.mark.parametrize("seed", range(1, 4))
def test_before_a_camera_that_turns_bodies_that_hold_two_fifths_of_the_tracks_are_no_translation(seed):
    """They pull the camera that only rotates, so that the tracks at rest seem to gain by the translation as well."""
    source, rng = point_source("rotation", seed, noise_px=0.3), np.random.default_rng(seed)
    views = pair_and_further(list(source.observations()), 8)
    depths, views_moved = rng.uniform(0.5, 1.5, 10_000), []
    for view in views:
        on_body = (view.track_ids % 5 < 2)[:, None]
        step = (view.frame - views[0].frame) * np.array([1.5, 0.5]) * depths[view.track_ids, None]
        pixels = view.pixels + on_body * step
        views_moved.append(replace(view, pixels=pixels, bearings=source.camera.bearings(pixels)))
    found = hypotheses_of(source.camera, views_moved, PRIORS)
    _, risk = confirmed(found, replace(risk_of(found), total=0.0, rotation=0.0), max_risk=0.005)
    assert risk.rotation > 0.5
