"""The focal length as an unknown of bundle adjustment: accuracy, prior, and failed steps."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from make_bundle import FOCAL, MAP, ROTATING, SIDEWAYS, map_errors
from make_map import CAMERAS
from make_scene import CAMERA, cloud, plane, problem

from slam_init.bundle import focal
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.focal import camera_with_focal_factor, lens_equations
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.lens_fit import unknowns_of_lens
from slam_init.bundle.problem import BundleSolution, PosePrior


@pytest.mark.parametrize("model", ["pinhole", "radtan5", "fisheye"])
def test_an_error_of_the_focal_length_of_5_percent_is_corrected_if_the_camera_rotates(model):
    """Noise 0.2 px, medians over four worlds: the errors of rotation and points are at least halved.

    The noise alone causes an error of half a degree in the direction of the baselines. This error must not grow by more
    than a fifth.
    """
    stated = camera_with_focal_factor(CAMERAS[model], 1.05)
    off, errors = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noisy = problem(CAMERAS[model], cloud(rng), ROTATING, 0.2, rng)
        held, adjusted = (adjust(stated, noisy, config) for config in (MAP, FOCAL))
        off.append(adjusted.focal_factor * 1.05 - 1)
        errors.append([map_errors(adjusted, noisy), map_errors(held, noisy)])
        assert abs(off[-1]) < 3 * adjusted.focal_factor_sigma
    assert np.median(np.abs(off)) < 0.5 * 0.05
    (rotation, direction, points), (rotation_held, direction_held, points_held) = np.median(errors, axis=0)
    assert rotation < 0.5 * rotation_held
    assert direction < 1.2 * direction_held
    assert points < 0.5 * points_held


@pytest.mark.parametrize("scene", [plane, cloud])
def test_without_rotation_the_focal_length_and_its_uncertainty_are_those_of_the_prior(scene):
    """A longer lens sees a scene stretched along the optical axis in the same way, so that only the prior remains."""
    rng = np.random.default_rng(2)
    noisy = problem(CAMERA, scene(rng), SIDEWAYS, 0.5, rng)
    solution = adjust(camera_with_focal_factor(CAMERA, 1.05), noisy, FOCAL)
    assert 0.95 * FOCAL.focal_sigma < solution.focal_factor_sigma <= 1.001 * FOCAL.focal_sigma
    assert abs(solution.focal_factor - 1) < 0.02
    narrow = adjust(CAMERA, noisy, replace(FOCAL, focal_sigma=0.01))
    assert narrow.focal_factor_sigma == pytest.approx(0.01, rel=0.05)


def test_if_all_steps_of_the_focal_length_fail_the_stated_one_is_kept(monkeypatch):
    rng = np.random.default_rng(0)
    noisy = problem(CAMERA, cloud(rng), ROTATING, 0.2, rng)
    monkeypatch.setattr(focal, "stepped", Mock(side_effect=RuntimeError("Indeterminant linear system")))
    solution = adjust(CAMERA, noisy, FOCAL)
    assert isinstance(solution, BundleSolution)
    assert solution.focal_factor == 1


def test_the_gradient_by_all_unknowns_of_a_lens_is_that_of_the_error_at_the_optima_of_poses_and_points():
    rng = np.random.default_rng(0)
    noisy = problem(CAMERAS["radtan"], cloud(rng), ROTATING, 0.3, rng).with_prior(PosePrior(1e-3, 1e-2))
    unknowns, at = unknowns_of_lens(CAMERAS["radtan"], CAMERA), np.array([0.01, 2.0, -1.0, 0.02, -0.01])

    def optimum(at):
        fitted, errors = minimize(with_lenses(unknowns.camera_at(at), noisy), 0.3, iterations=50, tolerance=0.0)
        pulls = (at - unknowns.mean) / unknowns.sigmas
        return fitted, 0.5 * len(noisy.views) * (errors[-1] / 0.3) ** 2 + 0.5 * pulls @ pulls

    steps = np.diag([1e-3, 0.1, 0.1, 1e-3, 1e-3])
    numeric = [(optimum(at + one)[1] - optimum(at - one)[1]) / (2 * one.sum()) for one in steps]
    np.testing.assert_allclose(lens_equations(unknowns, at, optimum(at)[0], 0.3).gradient, numeric, rtol=0.01)
