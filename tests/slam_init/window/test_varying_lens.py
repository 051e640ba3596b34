"""Laws of a lens that changes from view to view: it is reported where tracks show it, and costs nothing elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import hypotheses_of_changing_lens as hypotheses
from make_window import looks_small

from slam_init.window.direction_term import varying_lens
from slam_init.window.levels import ZOOMS
from slam_init.window.risk import risk_of, with_zooming_rotation
from slam_init.window.uncertainty import expand
from slam_init.window.zooming_rotation import with_zooms


def lens_of(found):
    return varying_lens(expand(found.motions[0]))


@pytest.mark.parametrize("scene", ["room", "corridor", "wall"])
def test_a_lens_that_is_the_same_in_all_views_is_reported(scene):
    found = hypotheses(scene, baseline=0.1)
    lens = lens_of(found)
    assert lens.probabilities[0] > 0.9


@pytest.mark.parametrize(("scene", "zoom", "shift"), [("room", 0.01, 0.0), ("wall", 0.01, 0.0), ("room", 0.0, 0.01)])
def test_a_lens_that_changes_is_reported(scene, zoom, shift):
    lens = lens_of(hypotheses(scene, zoom=zoom, shift=shift, baseline=0.1))
    assert lens.probabilities[0] < 0.01


@pytest.mark.parametrize("baseline", [0.03, 0.05])
def test_a_slow_zoom_is_reported(baseline):
    """It is one change and not one for each view: with independent zooms alone the lens seemed fixed (0.96, 0.86)."""
    plain, zoomed = (lens_of(hypotheses("room", ramp=ramp, baseline=baseline)) for ramp in (0.0, 0.01))
    assert plain.probabilities[0] > 0.99
    assert zoomed.probabilities[0] < 0.3
    by_mode = zoomed.probabilities[1 : 1 + 2 * len(ZOOMS)].reshape(len(ZOOMS), 2)
    assert by_mode[:, 0].sum() > 10 * by_mode[:, 1].sum()


def test_a_lens_that_is_said_to_be_fixed_has_no_other_modes():
    found = hypotheses("wall", baseline=0.05)
    priors = replace(found.priors, lens_changes=0.0)
    motions = tuple(replace(one, fit=replace(one.fit, priors=priors)) for one in found.motions)
    fixed = replace(found, priors=priors, motions=motions)
    lens = lens_of(fixed)
    assert lens.probabilities.tolist() == [1.0]
    risk, of_fixed = risk_of(found), risk_of(fixed)
    assert of_fixed.direction < risk.direction
    # What would be stated of a fixed lens is known without the option too.
    assert risk.directions.if_lens_fixed == pytest.approx(of_fixed.direction)
    assert of_fixed.directions.if_lens_fixed == pytest.approx(of_fixed.direction)


def test_the_direction_of_a_rigid_scene_knows_that_the_lens_may_change():
    """Otherwise a lens that changes would be taken for moving objects."""
    risk = risk_of(hypotheses("wall", zoom=0.02, baseline=0.05, points=300))
    assert risk.directions.if_lens_fixed < 0.2 * risk.directions.if_rigid


@pytest.mark.parametrize(("scene", "seed"), [("rotation", 1), ("static", 2)])
def test_a_camera_that_zooms_and_does_not_translate_has_no_small_risk(scene, seed):
    found = hypotheses(scene, seed, zoom=0.02)
    zoomed = with_zooms(found).hypotheses
    assert zoomed.rotation_only.cost < 0.7 * found.rotation_only.cost
    assert zoomed.gain_over_rotation[0] < 2 * zoomed.gain_over_rotation[1]
    risk = with_zooming_rotation(found, looks_small(risk_of(found)))
    assert risk.total > 0.005


@pytest.mark.parametrize(("scene", "seed", "ramp"), [("static", 3, -0.25), ("rotation", 1, 0.7)])
def test_a_person_who_zooms_does_not_move_toward_a_plane(scene, seed, ramp):
    found = hypotheses(scene, seed, ramp=ramp)
    assert with_zooms(found).hypotheses.rotation_only.cost < 0.4 * found.rotation_only.cost
    risk = with_zooming_rotation(found, looks_small(risk_of(found)))
    assert risk.total > 0.005


def test_what_the_model_of_a_zoom_lacks_is_no_motion():
    """A distortion that stays in the image, and wrong matches: a motion toward a plane explains more of both."""
    found = hypotheses("static", 8, ramp=0.3, image_k1=-0.02, jumping=0.1, points=300, noise_px=0.1)
    assert with_zooms(found).hypotheses.rotation_only.cost > found.motions[0].fit.cost + 1000
    risk = with_zooming_rotation(found, risk_of(found))
    assert risk.total > 0.005


@pytest.mark.parametrize(("scene", "seed"), [("static", 4), ("rotation", 4)])
def test_a_stabilizer_that_shifts_the_frames_of_a_camera_at_rest_makes_no_map(scene, seed):
    """A shift of a view looks like a motion along a plane."""
    found = hypotheses(scene, seed, shift=0.005, points=300)
    shifted = with_zooms(found)
    assert shifted.hypotheses.rotation_only.cost < 1.02 * found.motions[0].fit.cost
    assert np.abs(shifted.shifts).max() > 0.001 * found.tracks.camera.width
    risk = with_zooming_rotation(found, looks_small(risk_of(found)))
    assert risk.total > 0.005


def test_level_flight_over_flat_ground_is_no_stabilizer():
    """Shifts explain most of it, but they would be as large as no stabilizer's; and nothing on the ground moves."""
    found = hypotheses("nadir", 0, baseline=0.15, points=300)
    shifted = with_zooms(found)
    cost = shifted.hypotheses.rotation_only.cost
    assert found.rotation_only.cost - cost > cost - found.motions[0].fit.cost - shifted.price
    risk = with_zooming_rotation(found, risk_of(found))
    assert risk.total < 0.005
