"""Points that are fitted robustly to their rays, for poses that are known."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from make_bundle import read_problem, with_kernel
from make_map import CAMERAS
from make_scene import CAMERA, cloud, problem

from slam_init.bundle.graph import build_graph, pose_key
from slam_init.bundle.least_squares import fit_points, with_lenses


def moved(exact, rng, share=0.05):
    """The same observations with points at other distances."""
    return replace(exact, points=exact.points * rng.normal(1, share, (len(exact.points), 1)))


def fitted(camera, start, noise_px):
    return fit_points(with_lenses(camera, start), noise_px)


def errors(found, exact):
    return np.linalg.norm(found.points - exact.points, axis=1)


def test_an_outlier_pulls_a_point_far_less_than_in_least_squares():
    """One view of each point is off by 30 px; as an inlier it would move the point by a fifth of that."""
    rng = np.random.default_rng(1)
    exact = problem(CAMERA, cloud(rng))
    pixels = exact.pixels.copy()
    pixels[exact.views == 2] += (30.0, 0.0)
    wrong = replace(exact, pixels=pixels)
    robust, plain = (fitted(CAMERA, wrong, noise_px) for noise_px in (0.5, 60.0))
    assert np.median(errors(robust, exact)) < 0.1 * np.median(errors(plain, exact))


@pytest.mark.parametrize("model", ["radtan", "fisheye"])
def test_the_points_are_those_of_gtsam_where_its_poses_are_held(model):
    rng = np.random.default_rng(3)
    exact = problem(CAMERAS[model], cloud(rng), noise_px=0.5, rng=rng)
    noisy = moved(exact, rng, 0.02).keep(rng.random(len(exact.views)) < 0.8)
    graph, values = build_graph(CAMERAS[model], noisy, 0.5)
    graph = with_kernel(graph, len(noisy.views))
    held = gtsam.noiseModel.Isotropic.Sigma(6, 1e-8)
    for frame in noisy.frames:
        graph.add(gtsam.PriorFactorPose3(pose_key(frame), values.atPose3(pose_key(frame)), held))
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-12)
    theirs = read_problem(gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize(), noisy)
    off = np.linalg.norm(fitted(CAMERAS[model], noisy, 0.5).points - theirs.points, axis=1)
    assert (np.quantile(off, [0.5, 0.95]) < [1e-4, 2e-3]).all()
