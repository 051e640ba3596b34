"""The gtsam graph: gtsam projects as the camera does, and the graph of a solution is at its optimum."""

import gtsam
import numpy as np
import pytest
from make_bundle import FOCAL, ROTATING
from make_map import CAMERAS
from make_scene import cloud, problem

from slam_init.bundle.adjustment import adjust
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.bundle.reprojection import calibration_key, gtsam_calibration, measured_pixels


@pytest.mark.parametrize("model", CAMERAS)
def test_gtsam_projects_as_the_camera_does(model):
    camera, points = CAMERAS[model], cloud(np.random.default_rng(11), 40)
    pixels = measured_pixels(camera, camera.project(points))
    calibration = gtsam_calibration(camera)
    uncalibrated = np.array([calibration.uncalibrate(point[:2] / point[2]) for point in points])
    assert not isinstance(calibration, gtsam.Cal3_S2) or model in ("pinhole", "radtan5")
    np.testing.assert_allclose(uncalibrated, pixels, atol=1e-6)


@pytest.mark.parametrize("model", CAMERAS)
def test_the_graph_with_calibration_is_at_its_optimum_and_only_the_focal_length_has_changed(model):
    rng = np.random.default_rng(6)
    noisy = problem(CAMERAS[model], cloud(rng), ROTATING, 0.5, rng)
    stated = camera_with_focal_factor(CAMERAS[model], 1.05)
    solution = adjust(stated, noisy, FOCAL)
    assert solution.recipe.graph.size() == len(solution.problem.pixels) + 3  # priors of pose and calibration, range
    at = getattr(solution.recipe.values, f"at{type(gtsam_calibration(stated, adjusted=True)).__name__}")
    np.testing.assert_allclose(
        at(calibration_key()).vector(), gtsam_calibration(solution.camera, adjusted=True).vector()
    )
    again = gtsam.LevenbergMarquardtOptimizer(solution.recipe.graph, solution.recipe.values).optimize()
    assert solution.recipe.graph.error(again) == pytest.approx(
        solution.recipe.graph.error(solution.recipe.values), rel=1e-3
    )
    moved = getattr(again, f"at{type(gtsam_calibration(stated, adjusted=True)).__name__}")(calibration_key()).vector()
    vector = gtsam_calibration(solution.camera, adjusted=True).vector()
    # The noise of the graph is larger than that of the adjustment, by errors that tracks share: the prior counts more.
    assert abs(moved[0] / vector[0] - 1) < 0.5 * solution.focal_factor_sigma
    np.testing.assert_allclose(moved[:2] / moved[0], vector[:2] / vector[0], rtol=1e-4)
    np.testing.assert_allclose(moved[2:], vector[2:], atol=1e-6)
