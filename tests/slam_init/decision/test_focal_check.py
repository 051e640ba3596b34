"""Laws of the check of the stated focal length: what it names, when it looks, and what it refuses."""

from dataclasses import replace

import pytest
from make_window import point_source

from slam_init.calibration.files import prior_camera
from slam_init.initializer import Initializer

#: Scenes that determine the focal length, with their options: a camera that turns and moves, one that only turns, a
#: wall, whose motions by the stated lens suit it.
INFORMATIVE = {
    "rotate-then-move": {"baseline": 0.3, "views": 8},
    "rotation": {"views": 8},
    "handheld-wall": {"speed": 0.3, "views": 8},
}
OPTIONS = {"noise_px": 0.3, "points": 150}


def seen(camera, source):
    """The result of an initializer that sees the tracks of a source through a camera."""
    initializer = Initializer(camera)
    for observed in source.observations():
        if initializer.process_tracks(replace(observed, bearings=camera.bearings(observed.pixels))):
            break
    result = initializer.finish()
    assert initializer.status.wrong_focal == result.wrong_focal
    return result


@pytest.mark.slow
def test_a_focal_length_that_the_tracks_contradict_is_named_and_a_right_one_is_not():
    for scene, options in INFORMATIVE.items():
        # A wall has its map, a right one, before its tracks tell that the focal length is a seventh too short.
        for focal_error in (-0.4, 0.0, 0.15, 0.8) if scene == "handheld-wall" else (-0.4, -0.15, 0.0, 0.15, 0.8):
            source = point_source(scene, 1, focal_error=focal_error, **OPTIONS, **options)
            wrong = seen(source.camera, source).wrong_focal
            case = scene, focal_error, wrong
            assert (wrong is not None) == (focal_error != 0), case
            if wrong is not None:
                true_px = source.sequence.shot.camera.fx
                assert abs(wrong.estimated_px - true_px) < max(2 * wrong.sigma_px, 0.03 * true_px), case


@pytest.mark.slow
def test_a_wrong_motion_that_suits_a_wrong_focal_length_has_no_map():
    """Near a plane: with the plane held, the free fits of these stayed at the stated focal length."""
    for seed, focal_error in ((1, 0.5), (1, -0.4), (10, 0.8), (11, 1.0)):
        source = point_source("rotate-then-move", seed, focal_error=focal_error, **OPTIONS, baseline=0.3, views=8)
        result = seen(source.camera, source)
        assert result.map is None and result.wrong_focal is not None


def test_a_camera_of_which_nobody_stated_a_focal_length_is_not_checked():
    source = point_source("rotation", 1, **OPTIONS, **INFORMATIVE["rotation"])
    result = seen(prior_camera((source.camera.width, source.camera.height)), source)
    assert result.attempts
    assert all(attempt.free_focal is None for attempt in result.attempts)


def test_the_checks_of_refused_windows_decide_nothing():
    """The same camera as an estimate of an earlier run: it is not checked."""
    source = point_source("rotate-then-move", 1, focal_error=0.4, **OPTIONS, **INFORMATIVE["rotate-then-move"])
    checked, unchecked = (seen(replace(source.camera, source=origin), source) for origin in ("file", "estimated"))
    assert any(attempt.free_focal is not None for attempt in checked.attempts)
    assert unchecked.wrong_focal is None
    for one, other in zip(checked.attempts, unchecked.attempts, strict=True):
        assert (one.verdict, one.gates, one.window) == (other.verdict, other.gates, other.window)
