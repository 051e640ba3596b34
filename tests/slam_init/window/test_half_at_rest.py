"""Laws of the half of the tracks that a camera that only rotates explains best."""

import numpy as np
import pytest
from make_window import PRIORS, hypotheses_of, pair_and_further, point_source

from slam_init.window.half_at_rest import bodies_probability
from slam_init.window.levels import ON_BODIES, UNDECIDED
from slam_init.window.neighbours import far_halves


def hypotheses(scene, seed, **options):
    source = point_source(scene, seed, noise_px=0.3, points=150, **options)
    return hypotheses_of(source.camera, pair_and_further(list(source.observations()), 6), PRIORS)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_body_before_a_camera_that_only_rotates_is_no_motion_of_the_camera(seed):
    found = hypotheses("rotation", seed, moving=0.45, bodies=1, body_turn_deg_s=0)
    once, anew = (bodies_probability(found, ON_BODIES, anew=anew) for anew in (False, True))
    assert anew > UNDECIDED
    assert anew >= once


@pytest.mark.parametrize("seed", range(3))
def test_each_half_of_a_scene_shows_the_translation_of_the_camera_beside_a_body(seed):
    found = hypotheses("room", seed, moving=0.4, bodies=1)
    assert bodies_probability(found, ON_BODIES, anew=True) < 1e-6


def test_each_compact_half_lacks_the_tracks_around_its_centre():
    places = np.random.default_rng(0).uniform(0, 1, (200, 2))
    halves = list(far_halves(places))
    assert len(halves) == 9
    for half in halves:
        assert len(half) == 100
    corner, centre, opposite = (places[halves[k]] for k in (0, 4, 8))
    assert (corner.mean(axis=0) > 0.6).all() and (opposite.mean(axis=0) < 0.4).all()
    assert np.linalg.norm(centre - 0.5, axis=1).min() > 0.3
