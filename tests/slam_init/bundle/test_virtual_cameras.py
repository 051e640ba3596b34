"""Virtual cameras: their residuals are those of raw pixels, and maps with rays behind the image plane are adjusted."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from make_bundle import FOCAL, MAP, ROTATING, disturbed, map_errors
from make_lenses import LENSES, directions
from make_scene import problem

from slam_init.bundle.adjustment import adjust
from slam_init.bundle.graph import GraphRecipe


def problem_around(camera, noise_px, rng, poses=ROTATING, count=150):
    """Points in all directions, and those of their observations that the lens sees in every view."""
    points = directions(3 * count) * rng.uniform(1.5, 3.0, (3 * count, 1))
    exact = [camera.project(pose.inverse().apply(points)) for pose in poses]
    inside = np.all([np.isfinite(p).all(axis=1) & (np.abs(p - 320) < 400).all(axis=1) for p in exact], axis=0)
    made = problem(camera, points[inside][:count], poses, noise_px, rng)
    return made.keep(np.isfinite(camera.bearings(made.pixels)).all(axis=1))


@pytest.mark.parametrize("model", LENSES)
def test_the_errors_of_gtsam_are_the_residuals_of_the_raw_pixels(model):
    camera, rng = LENSES[model], np.random.default_rng(4)
    around = problem_around(camera, 0.1, rng, ROTATING[:2], 40)
    residuals = around.residuals(camera)
    graph, values = GraphRecipe(camera, around, 1.0).graph_and_values
    theirs = np.array([graph.at(i).error(values) for i in range(len(residuals))])
    ours = 0.5 * np.sum(residuals**2, axis=1)
    if model == "thin-prism":  # its factors measure undistorted pixels
        assert np.corrcoef(theirs, ours)[0, 1] > 0.8
    else:
        np.testing.assert_allclose(theirs, ours, rtol=0.05, atol=1e-4)


@pytest.mark.parametrize("model", ["fisheye", "double-sphere", "equirectangular"])
def test_a_map_with_rays_behind_the_image_plane_is_adjusted_to_the_truth(model):
    camera, rng = LENSES[model], np.random.default_rng(5)
    exact = problem_around(camera, 0.1, rng)
    solution = adjust(camera, disturbed(exact, rng), MAP)
    assert solution
    rotation_deg, direction_deg, points = map_errors(solution, exact)
    assert rotation_deg < 0.05
    assert direction_deg < 0.3
    assert points < 0.05
    assert (solution.problem.points[:, 2] < 0).sum() >= 5
    assert solution.rmse_px < 0.2
    again = gtsam.NonlinearFactorGraph()
    again.deserialize(solution.recipe.graph.serialize())
    assert again.error(solution.recipe.values) == pytest.approx(solution.recipe.graph.error(solution.recipe.values))


def test_a_focal_length_that_gtsam_cannot_adjust_stays_at_the_estimate_of_the_window():
    camera, rng = LENSES["double-sphere"], np.random.default_rng(6)
    exact = problem_around(camera, 0.1, rng)
    stated = replace(camera, fx=camera.fx / 1.04, fy=camera.fy / 1.04)
    solution = adjust(stated, exact, FOCAL, 1.04)
    assert solution
    assert solution.focal_factor == pytest.approx(1.04)
    assert solution.focal_factor_sigma == FOCAL.focal_sigma
    assert solution.camera.fx == pytest.approx(camera.fx)
    assert solution.rmse_px < 0.2
