"""Tracks from elsewhere: rays of other lengths and other axes are refused in one line, and change nothing."""

from dataclasses import replace

import numpy as np
import pytest

from slam_init import Camera, Initializer, Observations, SlamInitError

CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)


def tracks(frame, axes=(1.0, 1.0, 1.0)):
    rng = np.random.default_rng(0)
    points = rng.uniform((-1.0, -0.8, 2.0), (1.0, 0.8, 4.0), (300, 3)) - (0.2 * frame, 0.0, 0.0)
    pixels = CAMERA.project(points) + 0.3 * np.random.default_rng(frame + 1).normal(size=(300, 2))
    bearings = CAMERA.bearings(pixels) * axes
    return Observations(frame, float(frame), "", np.arange(300), pixels, bearings)


@pytest.mark.parametrize(
    ("axes", "named"),
    [
        ((1, -1, -1), "OpenGL"),
        ((1, -1, 1), "y up"),
        ((-1, -1, 1), "x left"),
        ((-1, -1, -1), "from the points to the camera"),
        ((1, 1, -1), "z backward"),
    ],
)
def test_rays_in_other_axes_are_named(axes, named):
    with pytest.raises(SlamInitError, match=named):
        Initializer(CAMERA).process_tracks(tracks(0, axes))


def test_rays_of_another_camera_are_reported():
    other = Camera("pinhole", 640, 480, 250.0, 250.0, 319.5, 239.5)
    observed = tracks(0)
    with pytest.raises(SlamInitError, match=r"give camera\.bearings"):
        Initializer(CAMERA).process_tracks(replace(observed, bearings=other.bearings(observed.pixels)))
