"""Laws that rendered worlds and worlds of tracks have in common: options, stated cameras, motions, cuts."""

from itertools import pairwise

import numpy as np
import pytest

from sequences_synth import PointOptions, SynthOptions, make_points, make_sequence
from sequences_synth.trajectory import vector_from_rotation

RENDERED = {"width": 160, "height": 120, "noise": 0.0, "motion_blur": 0.0, "exposure_change": 0.0}


class Points:
    """Worlds of tracks, at the rate of a video."""

    @staticmethod
    def make(scene, seed, frames=100, **options):
        return make_points(scene, seed, PointOptions(**{"views": frames, "fps": 30.0, **options}))

    @staticmethod
    def shown(world, index):
        return world.pixels[index], world.visible[index]


class Rendered:
    """Rendered worlds of small images."""

    @staticmethod
    def make(scene, seed, **options):
        return make_sequence(scene, seed, SynthOptions(**{**RENDERED, **options}))

    @staticmethod
    def shown(world, index):
        return world.render(index)


@pytest.fixture(params=[Points, Rendered], ids=["points", "rendered"])
def kind(request):
    return request.param


def same(kind, a, i, b, j):
    """Whether frame i of a world shows the same as frame j of another."""
    return all(np.array_equal(x, y) for x, y in zip(kind.shown(a, i), kind.shown(b, j), strict=True))


def turning_deg_s(world):
    """Root mean square of the angular speed from view to view."""
    angles = [np.linalg.norm(vector_from_rotation(a.T @ b)) for a, b in pairwise(world.poses[:, :3, :3])]
    return np.degrees(np.sqrt(np.mean((np.array(angles) / np.diff(world.timestamps_s)) ** 2)))


OF_BOTH = [
    {"k1": -1.0}, {"readout_ms": -1.0}, {"readout_ms": 400.0}, {"readout_direction": "in"}, {"principal_error": 0.6},
    {"turning_deg_s": float("nan")},
]  # fmt: skip
OF_POINTS = [{"fps": 0.0}, {"correlated_px": -1.0}, {"moving": 2.0}, {"objects": 0}]
OF_RENDERED = [
    {"cut": 100},
    {"readout_direction": "left"},
    {"frames": 0},
    {"noise": -1.0},
    {"lens": "glass"},
    {"lens": "fisheye", "k1": 0.1},
]


def test_options_out_of_range_are_refused_by_name():
    for made, options in ((PointOptions, OF_BOTH + OF_POINTS), (SynthOptions, OF_BOTH + OF_RENDERED)):
        for one in options:
            with pytest.raises(ValueError, match=next(iter(one))):
                made(**one)
    for make in (make_points, make_sequence):
        with pytest.raises(ValueError, match=r"'moon'.*room, wall, nadir"):
            make("moon")


def test_equal_seeds_give_equal_worlds_and_different_seeds_different_ones(kind):
    a, b, c = (kind.make("desk", seed, frames=12) for seed in (5, 5, 6))
    assert same(kind, a, 11, b, 11)
    assert not np.allclose(a.poses[6], c.poses[6], atol=1e-3)
    assert not same(kind, a, 11, c, 11)


def true_camera(sequence):
    return sequence.sensors[0].camera if hasattr(sequence, "sensors") else sequence.shot.camera


def test_calibration_errors_change_only_the_stated_camera(kind):
    right, scaled, shifted = (
        kind.make("wall", 0, frames=6, **options) for options in ({}, {"focal_error": 0.05}, {"principal_error": 0.03})
    )
    assert right.camera == true_camera(right) == true_camera(scaled) == true_camera(shifted)
    assert scaled.camera.fx == scaled.camera.fy == pytest.approx(1.05 * right.camera.fx)
    assert abs(shifted.camera.cx - right.camera.cx) == pytest.approx(0.03 * right.camera.width)
    assert abs(shifted.camera.cy - right.camera.cy) == pytest.approx(0.03 * right.camera.height)
    for wrong in (scaled, shifted):
        assert same(kind, right, 5, wrong, 5) and np.array_equal(right.poses, wrong.poses)
    bent = kind.make("wall", 0, frames=6, k1=0.1)
    assert bent.camera == right.camera and true_camera(bent).coefficients[0] == 0.1


def test_a_turning_camera_has_the_requested_speed_and_no_translation(kind):
    for scene, speed in (("handheld", 20.0), ("handheld-wall", 150.0), ("pan", 60.0)):
        world = kind.make(scene, 1, frames=201, turning_deg_s=speed)
        assert turning_deg_s(world) == pytest.approx(speed, rel=0.03)
        assert (world.poses[:, :3, 3] == world.poses[0, :3, 3]).all()


@pytest.mark.parametrize("scene", ["handheld", "handheld-wall"])
def test_a_hand_held_camera_translates_at_a_constant_speed(kind, scene):
    world = kind.make(scene, 4, frames=90, speed=0.1)
    steps = np.linalg.norm(np.diff(world.poses[:, :3, 3], axis=0), axis=1) * 30
    np.testing.assert_allclose(steps, steps[0], rtol=1e-3)
    assert 0.1 < steps[0] < 0.5


def test_the_first_scene_of_a_cut_is_a_scene_of_its_own_length():
    whole, part = Rendered.make("handheld", 3, frames=10, cut=6), Rendered.make("handheld", 3, frames=6)
    np.testing.assert_array_equal(whole.poses[:6], part.poses)
    assert same(Rendered, whole, 5, part, 5)
    assert np.abs(whole.poses[6] - whole.poses[5]).max() > 1e-3
