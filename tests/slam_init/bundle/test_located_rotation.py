"""Laws of the deviation of a located rotation: it is that of the covariances, and holds the errors that views share."""

import math

import numpy as np
import pytest
from make_scene import CAMERA, cloud, problem

from slam_init.bundle.adjustment import solution_of
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.located_rotation import LocatedRotation
from slam_init.config import MapConfig
from slam_init.types.pose import Pose

CONFIG = MapConfig()
#: A camera that goes to the side, and turns the whole time.
POSES = [
    Pose(np.array([[math.cos(a), 0, -math.sin(a)], [0, 1, 0], [math.sin(a), 0, math.cos(a)]]), np.array([x, 0, 0.0]))
    for x, a in ((0.0, 0.0), (0.3, 0.02), (0.6, 0.04), (0.6, 0.25))
]


def optimum(points, noise_px, seed):
    """A map at its optimum, of all views."""
    rng = np.random.default_rng(seed)
    seen = with_lenses(CAMERA, problem(CAMERA, points, POSES, noise_px, rng))
    return minimize(seen, noise_px, iterations=20, tolerance=1e-9)[0]


def test_it_is_that_of_the_covariances_of_a_map_of_few_landmarks():
    full = optimum(cloud(np.random.default_rng(0), 80), 0.3, 0)
    stated = solution_of(CAMERA, full, CONFIG).pose_covariances[-1, :3, :3]
    found = LocatedRotation.of(CAMERA, full, CONFIG).sigma_rad(full)
    assert found == pytest.approx(math.sqrt(np.linalg.eigvalsh(stated)[-1]), rel=1e-9)
