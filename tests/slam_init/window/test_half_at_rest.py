"""Laws of the half of the tracks that a camera that only rotates explains best."""

import numpy as np
import pytest
from make_window import PRIORS, hypotheses_of, pair_and_further, point_source

from slam_init.config import AcceptanceConfig
from slam_init.window.half_at_rest import beside_bodies, bodies_probability
from slam_init.window.levels import ON_BODIES, UNDECIDED
from slam_init.window.neighbours import far_from_places

MAX_RISK = AcceptanceConfig().max_risk


def hypotheses(scene, seed, **options):
    source = point_source(scene, seed, noise_px=0.3, points=150, **options)
    return hypotheses_of(source.camera, pair_and_further(list(source.observations()), 6), PRIORS)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_body_before_a_camera_that_only_rotates_is_no_motion_of_the_camera(seed):
    found = hypotheses("rotation", seed, moving=0.45, bodies=1, body_turn_deg_s=0)
    once, anew = (beside_bodies(found, anew=anew) for anew in (False, True))
    assert anew > UNDECIDED
    assert anew >= once


@pytest.mark.parametrize("seed", range(3))
def test_each_half_of_a_scene_shows_the_translation_of_the_camera_beside_a_body(seed):
    found = hypotheses("room", seed, moving=0.4, bodies=1)
    assert beside_bodies(found, anew=True) < 0.01


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_body_that_holds_more_than_half_of_the_tracks_is_unlikely_but_not_impossible(seed):
    found = hypotheses("rotation", seed, moving=0.55, bodies=1, body_turn_deg_s=0)
    assert bodies_probability(found, ON_BODIES) < 1e-9
    assert MAX_RISK < beside_bodies(found, anew=True) < UNDECIDED


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_each_rest_of_the_view_lacks_the_tracks_around_a_place(share):
    places = np.random.default_rng(0).uniform(0, 1, (200, 2))
    rests = list(far_from_places(places, share))
    assert len(rests) == 9
    for rest in rests:
        assert len(rest) == round((1 - share) * 200)
    corner, centre, opposite = (places[rests[k]] for k in (0, 4, 8))
    assert (corner.mean(axis=0) > 0.6).all() and (opposite.mean(axis=0) < 0.4).all()
    assert np.linalg.norm(centre - 0.5, axis=1).min() > 0.3
