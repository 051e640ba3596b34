"""The deviation of a located rotation is that of the covariances."""

import math

import numpy as np
import pytest
from make_bundle import ROTATING
from make_scene import CAMERA, cloud, problem

from slam_init.bundle.adjustment import solution_of
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.shared_errors import LocatedRotation
from slam_init.config import MapConfig


def test_it_is_that_of_the_covariances_of_a_map_of_few_landmarks():
    rng, config = np.random.default_rng(0), MapConfig()
    seen = with_lenses(CAMERA, problem(CAMERA, cloud(rng, 80), ROTATING, 0.3, rng))
    full, _ = minimize(seen, 0.3, iterations=20, tolerance=1e-9)
    stated = solution_of(CAMERA, full, config).pose_covariances[-1, :3, :3]
    found = LocatedRotation.of(CAMERA, full, config).sigma_rad(full)
    assert found == pytest.approx(math.sqrt(np.linalg.eigvalsh(stated)[-1]), rel=1e-9)
