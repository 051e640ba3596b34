"""Laws of a rigid motion among the tracks that the best motion does not explain."""

import math
from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, hypotheses_of, pair_and_further, point_source

from slam_init.window.hypotheses import OverlayTracks
from slam_init.window.levels import FLOOR
from slam_init.window.motion import OtherMotion, farthest_deg
from slam_init.window.other_motion import other_motion
from slam_init.window.risk import risk_of


def source_of(seed, **options):
    return point_source("room", seed, baseline=0.3, noise_px=0.3, points=150, **options)


def hypotheses(seed, views=6, **options):
    source = source_of(seed, **options)
    return hypotheses_of(source.camera, pair_and_further(list(source.observations()), views), PRIORS)


@pytest.mark.parametrize("seed", range(2))
def test_a_scene_at_rest_has_no_other_motion_however_many_outliers_there_are(seed):
    found = hypotheses(seed, outliers=0.4)
    assert other_motion(found).probability == 0
    assert 0.5 < found.explained.mean() < 0.7


@pytest.mark.parametrize("seed", range(2))
def test_a_moving_object_with_as_many_tracks_as_the_scene_around_it_may_be_the_scene_but_less_likely(seed):
    found = hypotheses(seed, views=10, moving=0.45, objects=1, object_deg_s=30, outliers=0.05)
    assert 0.05 < risk_of(found).moving == other_motion(found).probability < 0.5


def test_a_small_moving_object_is_no_competing_motion():
    for seed in range(3):
        found = hypotheses(seed, moving=0.1, objects=1, object_deg_s=30, outliers=0.05)
        assert other_motion(found).probability == 0
        assert found.explained.mean() > 0.75


def test_a_new_motion_is_sought_only_where_it_can_decide_and_one_that_is_known_is_followed():
    found = hypotheses(1, views=10, moving=0.45, objects=1, object_deg_s=30, outliers=0.05)
    sought = other_motion(found)
    assert other_motion(found, seeks=False).probability == 0 < sought.probability
    follows = replace(found, other_before=sought)
    assert other_motion(follows, seeks=False).probability == pytest.approx(sought.probability, rel=0.5)


def test_the_odds_of_a_motion_do_not_fall_while_it_is_found_beside_a_best_motion_of_the_same_tracks():
    found = hypotheses(1, views=10, moving=0.45, objects=1, object_deg_s=30, outliers=0.05)
    sought = other_motion(found)
    likely = replace(sought, probability=0.9)
    assert other_motion(replace(found, other_before=likely)).probability == 0.9
    exchanged = replace(likely, track_ids=sought.of_best, of_best=sought.track_ids)
    assert other_motion(replace(found, other_before=exchanged)).probability == pytest.approx(
        sought.probability, rel=0.5
    )
    # A motion that is not found again was none.
    alone = hypotheses(0, outliers=0.4)
    known = replace(likely, of_best=alone.tracks.track_ids)
    assert other_motion(replace(alone, other_before=known)).probability == 0


def test_tracks_that_only_turn_are_explained_by_any_motion_and_stay_as_probable():
    """Before a camera that turns, a moving object's motion explains the scene as points at infinity."""
    options = {"baseline": 0.0, "noise_px": 0.3, "points": 200, "moving": 0.6, "objects": 1, "object_deg_s": 30}
    source = point_source("room", 0, **options)
    found = hypotheses_of(source.camera, pair_and_further(list(source.observations()), 6), PRIORS)
    ids = found.tracks.track_ids
    on_object = source.sequence.shot.objects.object_of_track[ids] >= 0
    for theirs, expected in ((~on_object, 0.9), (on_object, 0.0)):
        before = OtherMotion(0.9, ids[theirs], of_best=ids[found.explained])
        assert other_motion(replace(found, other_before=before), seeks=False).probability == expected


def test_a_motion_within_the_deviations_of_the_best_one_may_contradict_its_map():
    found = hypotheses(1, views=10, moving=0.45, objects=1, object_deg_s=30, outliers=0.05)
    certain = other_motion(found)
    rotation_deg, direction_deg = farthest_deg(found.motions[0].motion, certain.fitted.motion)
    assert certain.probability == other_motion(found, 1.0, 4.0).probability > 0
    # As if the best motion were known so well that a map by it is right in spite of the other one.
    assert other_motion(found, -rotation_deg, -direction_deg).probability == 0


def overlay(count, share, half_width=0.5):
    x, y = np.meshgrid(*2 * [np.linspace(-half_width, half_width, math.isqrt(count))])
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    return OverlayTracks(np.arange(x.size), rays / np.linalg.norm(rays, axis=1, keepdims=True), share)


def test_tracks_that_stay_at_their_pixel_may_be_the_scene_before_a_camera_that_stands():
    found = hypotheses(0)
    values = [other_motion(replace(found, overlay=overlay(100, share))).probability for share in (0.1, 0.3, 0.45)]
    assert values == sorted(values)
    assert values[0] < FLOOR
    assert values[-1] > 0.1
    # A logo in a corner is no scene.
    assert other_motion(replace(found, overlay=overlay(100, 0.3, 0.05))).probability < 1e-4
    assert other_motion(replace(found, overlay=overlay(16, 0.45))).probability == 0


@pytest.mark.parametrize("seed", range(2))
def test_where_the_tracks_of_the_scene_only_turn_a_moving_object_that_holds_more_of_them_is_not_taken_for_it(seed):
    source = point_source("room", seed, baseline=0.0, noise_px=0.3, points=200, moving=0.6, objects=1, object_deg_s=30)
    found = hypotheses_of(source.camera, pair_and_further(list(source.observations()), 8), PRIORS)
    on_object = source.sequence.shot.objects.object_of_track >= 0
    assert on_object[found.tracks.track_ids[found.explained]].all()
    other = other_motion(found)
    assert other.probability > 0.01
    assert not on_object[other.track_ids].any()
