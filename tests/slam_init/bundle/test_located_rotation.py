"""Laws of the deviation of a located rotation: it is that of the covariances, and holds the errors that views share."""

import math
from dataclasses import replace

import numpy as np
import pytest
from make_scene import CAMERA, cloud, problem, with_random_lens

from quest.geometry.quaternion import rotation_angle
from slam_init.bundle.adjustment import adjust, solution_of
from slam_init.bundle.covariances import lens_prior
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.shared_errors import LocatedRotation
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


def test_it_holds_what_a_lens_and_each_view_have_in_common():
    """24 worlds whose views are shifted by a twentieth of a pixel, through lenses that are off as their prior says."""
    ratios = []
    for seed in range(16, 40):
        rng = np.random.default_rng(seed)
        true = with_random_lens(CAMERA, lens_prior(CAMERA, CONFIG).sigmas, rng)
        seen = problem(true, cloud(rng, 80), POSES, 0.2, rng)
        seen = replace(seen, pixels=seen.pixels + rng.normal(0, 0.05, (len(POSES), 2))[seen.views])
        if solution := adjust(CAMERA, seen, CONFIG, poses_known=True):
            full = with_lenses(CAMERA, solution.problem)
            turned = full.world_from_cam[-1].R.T @ full.world_from_cam[0].R
            error_rad = float(rotation_angle(turned @ (POSES[-1].inverse() @ POSES[0]).R.T))
            ratios.append(error_rad / LocatedRotation.of(CAMERA, full, CONFIG).sigma_rad(full))
    assert len(ratios) >= 18
    # Of Gaussian errors along one axis 5 % are beyond two deviations, and more than a quarter once in ten thousand.
    assert np.mean(np.array(ratios) > 2.0) <= 0.25
    assert np.median(ratios) > 0.2
