"""Laws of the term of the rotation: a camera that only rotates never has a small risk."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import hypotheses_of, pair_and_further, point_source
from make_window import hypotheses_of_scene as hypotheses

from quest.geometry.quaternion import rotation_from_vector
from slam_init.config import AcceptanceConfig
from slam_init.window.levels import ON_OBJECTS, UNDECIDED
from slam_init.window.risk import risk_of
from slam_init.window.rotation_term import moving_objects_probability, rotation_probability
from slam_init.window.state import Priors
from slam_init.window.uncertainty import expand

PRIORS = Priors(focal_sigma=0.03)
MAX_RISK = AcceptanceConfig().max_risk


@pytest.fixture(scope="module")
def clear():
    """A room in six views."""
    return hypotheses("room", 0, 6)


def test_the_rotation_term_falls_with_the_gain_over_the_rotation_only_camera(clear):
    cost, expanded = clear.motions[0].fit.cost, expand(clear.motions[0])
    gains, probabilities, *_ = zip(
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


def test_a_gain_weighs_less_where_the_image_moved_further_for_a_tracker_keeps_errors(clear):
    cost, fit = clear.motions[0].fit.cost, clear.rotation_only
    views = len(fit.state.R)

    def rotation_term(turn_deg):
        turns = np.radians(turn_deg) * np.arange(views) / (views - 1)
        R = np.array([rotation_from_vector(turn * np.array([0.0, 1.0, 0.0])) for turn in turns])
        turned = replace(fit, cost=cost + 700.0, state=replace(fit.state, R=R))
        noisy = replace(clear, tracks=clear.tracks.with_noise(0.1), rotation_only=turned)
        return rotation_probability(noisy, expand(clear.motions[0]))[1]

    none, little, much, most = map(rotation_term, (0.0, 1.0, 5.0, 20.0))
    assert none <= little <= much <= most
    assert none < 1e-3
    assert most > 0.9


def turned_views(scene, seed, turn_deg, lasting_px=0.0, on_object=0.0, **options):
    """Three views, of which the later ones are turned; a tracker keeps an error of each track in both of them."""
    source, rng = point_source(scene, seed, noise_px=0.1, **options), np.random.default_rng(seed)
    views = pair_and_further(list(source.observations())[::5][:3], 3)
    ids = np.unique(np.concatenate([view.track_ids for view in views]))
    errors, moves = rng.normal(0, lasting_px, (len(ids), 2)), rng.random(len(ids)) < on_object
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


@pytest.mark.parametrize("seed", range(2))
def test_two_views_show_a_translation_beyond_what_a_tracker_keeps(seed):
    """With a noise of a third of these errors, chance would gain more than outliers gain at the most."""
    camera, views = turned_views("room", seed, 20.0, baseline=0.3)
    found = hypotheses_of(camera, views[:2], PRIORS)
    risk = risk_of(found)
    assert risk.lasting_in_noise
    assert rotation_probability(found, expand(found.motions[0]))[1] > UNDECIDED
    assert risk.rotation < 1e-3


@pytest.mark.parametrize(("seed", "views"), [(0, 2), (1, 3)])
def test_moving_objects_before_a_turning_camera_are_no_translation_whatever_its_tracker_keeps(seed, views):
    """A third of the tracks is on a moving object; the errors that the others keep gain for a translation as well."""
    camera, turned = turned_views("rotation", seed, 15.0, lasting_px=0.3, on_object=0.3)
    found = hypotheses_of(camera, turned[:views], PRIORS)
    assert risk_of(found).rotation > 0.5


def test_a_rotation_only_camera_of_wrong_focal_length_never_has_a_small_risk():
    """Where the focal length is wrong, quest takes some rotation-only cameras for moving ones."""
    for seed, views in ((0, 12), (4, 8), (6, 10)):
        found = hypotheses("rotation", seed, views, views - 1, focal_error=0.05)
        assert risk_of(found).total > MAX_RISK


@pytest.mark.parametrize("seed", range(1, 3))
def test_before_a_camera_that_turns_moving_objects_that_hold_two_fifths_of_the_tracks_are_no_translation(seed):
    """They pull the camera that only rotates, so that the tracks at rest seem to gain by the translation as well."""
    source, rng = point_source("rotation", seed, noise_px=0.3), np.random.default_rng(seed)
    views = pair_and_further(list(source.observations()), 8)
    depths, views_moved = rng.uniform(0.5, 1.5, 10_000), []
    for view in views:
        on_object = (view.track_ids % 5 < 2)[:, None]
        step = (view.frame - views[0].frame) * np.array([1.5, 0.5]) * depths[view.track_ids, None]
        pixels = view.pixels + on_object * step
        views_moved.append(replace(view, pixels=pixels, bearings=source.camera.bearings(pixels)))
    found = hypotheses_of(source.camera, views_moved, PRIORS)
    assert risk_of(found).rotation > MAX_RISK


@pytest.mark.parametrize("seed", range(3))
def test_each_half_of_a_scene_shows_the_translation_of_the_camera_beside_a_moving_object(seed):
    source = point_source("room", seed, noise_px=0.3, points=150, moving=0.4, objects=1)
    found = hypotheses_of(source.camera, pair_and_further(list(source.observations()), 6), PRIORS)
    assert moving_objects_probability(found, ON_OBJECTS) < 1e-6
