"""Laws of rotations that another sensor measured: they are measurements of the joint fit, and nothing without them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from make_window import WINDOW_CONFIG, point_source

from quest.geometry.quaternion import rotation_from_vector
from slam_init.initializer import Initializer
from slam_init.types.inertial import RelativeRotation

SIGMA_RAD = 1e-3


def steps_of(source, noise_rad=0.0):
    """The true rotation of each frame since the one before, with noise; None for the first frame."""
    poses = [pose.inverse() for pose in source.groundtruth.world_from_cam]
    rng = np.random.default_rng(0)
    return [None] + [
        rotation_from_vector(noise_rad * rng.normal(size=3)) @ after.R @ before.R.T for before, after in pairwise(poses)
    ]


def windows(source, camera, rotations, most=100):
    """The evidence of the windows until the map, and the initializer."""
    initializer, found = Initializer(camera, WINDOW_CONFIG), []
    for seen, rotation in zip(source.observations(), rotations, strict=True):
        status = initializer.process_tracks(seen, rotation=rotation, rotation_sigma_rad=SIGMA_RAD)
        if status.attempt is not None and status.attempt.window is not None:
            found.append(status.attempt.window)
        if status or len(found) == most:
            break
    return found, initializer


def test_a_measured_rotation_makes_the_rotation_and_the_direction_more_certain():
    source = point_source("wall", 2, baseline=0.05, views=8)
    without = windows(source, source.camera, [None] * 8, most=1)[0][0]
    measured = windows(source, source.camera, steps_of(source, SIGMA_RAD), most=1)[0][0]
    assert measured.rotation_sigma_deg < without.rotation_sigma_deg
    assert measured.rotation_sigma_deg < 2 * np.degrees(SIGMA_RAD)
    assert measured.direction_sigma_deg < without.direction_sigma_deg


def test_it_determines_the_focal_length_of_a_camera_that_turns():
    source = point_source("rotation", 3, views=6)
    camera = replace(source.camera, fx=1.3 * source.camera.fx, fy=1.3 * source.camera.fy, focal_sigma=0.35)
    found, initializer = windows(source, camera, steps_of(source, SIGMA_RAD))
    assert initializer.map is None
    assert found[-1].focal_factor == pytest.approx(1 / 1.3, rel=0.03)


def test_a_frame_without_a_measurement_breaks_the_chain():
    first = RelativeRotation(np.eye(3), 0.0, 0)
    second = first.after(rotation_from_vector(np.array([0.0, 0.1, 0.0])), 0.01)
    assert (second.start, second.variance_rad2) == (0, pytest.approx(1e-4))
    source = point_source("static", 1, views=4)
    rotations = steps_of(source)
    rotations[2] = None
    history = windows(source, source.camera, rotations)[1].history
    assert [history.relative_rotations[frame].start for frame in range(4)] == [0, 0, 2, 2]
