"""Laws of a lens that the window estimates: its prior stays, its estimate is followed, and no motion is made up."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from make_scene import CAMERA
from make_window import WINDOW_CONFIG, fed, is_right, point_source

from slam_init.decision.lens import followed, priors_of
from slam_init.initializer import Initializer
from slam_init.types.lens import CurrentLens, Lens
from slam_init.types.refusal import Verdict

UNKNOWN = replace(CAMERA, focal_sigma=0.35, source="prior")


def withheld(source, factor):
    """The camera of a source with a focal length that is off by a factor, and said to be no calibration."""
    camera = source.camera
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor, focal_sigma=0.35, source="prior")


def initialized(source, camera):
    return fed(Initializer(camera, WINDOW_CONFIG), source.observations()).finish()


def test_a_calibrated_lens_follows_nothing():
    lens = CurrentLens.of(CAMERA)
    assert not lens.is_unknown
    assert followed(lens, Lens(0.3, 0.1)) is lens


def test_the_lens_of_a_machine_hardly_changes_and_fixes_no_more_than_a_person_who_says_so():
    of = {
        kind: priors_of(CurrentLens.of(replace(CAMERA, source=kind)), WINDOW_CONFIG).lens_changes
        for kind in ("stated", "file", "machine")
    }
    assert 0 < of["machine"] < of["file"] == of["stated"] == WINDOW_CONFIG.acceptance.lens_changes


def test_a_lens_that_moves_takes_its_prior_along():
    lens = followed(CurrentLens.of(UNKNOWN), Lens(0.2, -0.1))
    np.testing.assert_allclose(lens.camera.fx, CAMERA.fx * np.exp(0.2))
    assert lens.camera.distortion[0] == -0.1
    priors = priors_of(lens, WINDOW_CONFIG)
    assert (priors.mean.log_scale, priors.mean.k1, priors.focal_sigma) == (-0.2, 0.1, 0.35)
    # Back again, the prior is the first one.
    lens = lens.moved(-0.2, 0.1)
    assert priors_of(lens, WINDOW_CONFIG).mean.log_scale == pytest.approx(0)
    np.testing.assert_allclose(lens.camera.fx, CAMERA.fx)


def room():
    return point_source("room", 1, baseline=0.1, views=16, points=200)


@cache
def uncalibrated(factor):
    """The result of the room without its calibration."""
    return initialized(room(), withheld(room(), factor))


def test_a_stated_focal_length_is_at_least_as_well_known_as_it_was_stated():
    source = point_source("nadir", 1, baseline=0.2, views=12)
    result = initialized(source, replace(source.camera, source="stated", focal_sigma=0.05))
    assert result.map is not None
    assert result.map.camera.focal_sigma <= 0.05


@pytest.mark.parametrize("factor", [0.65, 1.5])
def test_a_map_without_a_calibration_has_the_true_focal_length_within_three_sigmas(factor):
    source, result = room(), uncalibrated(factor)
    camera = result.map.camera
    assert camera.source == "estimated"
    assert camera.focal_sigma <= 0.06
    assert abs(np.log(camera.fx / source.camera.fx)) < 3 * camera.focal_sigma
    assert is_right(source, result.map)


def test_a_camera_that_only_turns_has_no_map_and_reveals_its_focal_length():
    source = point_source("rotation", 3, views=12)
    result = initialized(source, withheld(source, 1.4))
    assert result.map is None
    assert result.reason is Verdict.PURE_ROTATION
    windows = [attempt.window for attempt in result.attempts if attempt.window is not None]
    assert windows[-1].focal_factor == pytest.approx(1 / 1.4, rel=0.1)


def test_the_tracks_of_the_user_are_seen_through_the_lens_in_use():
    camera = withheld(room(), 0.65)
    rays_of_another = [replace(seen, bearings=camera.bearings(seen.pixels)) for seen in room().observations()]
    initializer = fed(Initializer(camera, WINDOW_CONFIG), rays_of_another)
    np.testing.assert_array_equal(initializer.map.points, uncalibrated(0.65).map.points)
