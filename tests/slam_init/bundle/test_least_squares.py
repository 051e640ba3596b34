"""Least squares without gtsam: its equations, optimum and covariances are those of gtsam's graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from make_bundle import disturbed, read_problem, with_kernel
from make_map import CAMERAS
from make_scene import cloud, problem

from quest.geometry.quaternion import rotation_angle
from slam_init.bundle.covariances import ErrorModel, covariances
from slam_init.bundle.graph import GraphRecipe, landmark_key, pose_key
from slam_init.bundle.least_squares import fit_points, minimize, with_lenses
from slam_init.bundle.problem import PosePrior
from slam_init.types.lens import LensPrior

PRIOR = PosePrior(1e-3, 1e-2)


def noisy_problem(model, rng, prior=None, share=0.8):
    """Noise of half a pixel; some observations are missing, so that the points differ in their views."""
    exact = problem(CAMERAS[model], cloud(rng), noise_px=0.5, rng=rng)
    start = disturbed(exact, rng).keep(rng.random(len(exact.views)) < share)
    return with_lenses(CAMERAS[model], start if prior is None else start.with_prior(prior))


def optimum_of_gtsam(camera, start, robust=False, poses_held=False):
    """gtsam's graph of a problem, and its optimum."""
    graph, values = GraphRecipe(camera, start, 0.5).graph_and_values
    if robust:
        graph = with_kernel(graph, len(start.views))
    held = gtsam.noiseModel.Isotropic.Sigma(6, 1e-8)
    for frame in start.frames if poses_held else ():
        graph.add(gtsam.PriorFactorPose3(pose_key(frame), values.atPose3(pose_key(frame)), held))
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-12)
    return graph, gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


@pytest.mark.parametrize(
    ("model", "prior"), [("pinhole", None), ("radtan", PRIOR), ("radtan5", None), ("fisheye", PRIOR)]
)
def test_the_optimum_and_its_covariances_are_those_of_gtsam(model, prior):
    camera, start = CAMERAS[model], noisy_problem(model, np.random.default_rng(0), prior)
    graph, values = optimum_of_gtsam(camera, start)
    theirs = read_problem(values, start)
    ours, errors = minimize(start, 0.5, iterations=30, tolerance=1e-12)
    marginals = gtsam.Marginals(graph, values)
    expected = np.array([marginals.marginalCovariance(pose_key(frame)) for frame in start.frames])
    sigmas = np.sqrt(np.einsum("kii->ki", expected))
    for k, (one, other) in enumerate(zip(ours.world_from_cam, theirs.world_from_cam, strict=True)):
        assert rotation_angle(one.R.T @ other.R) <= 0.01 * sigmas[k, :3].max() + 1e-12
        assert np.linalg.norm(one.t - other.t) <= 0.01 * sigmas[k, 3:].max() + 1e-12
    assert graph.error(values) == pytest.approx(0.5 * len(start.views) * (errors[-1] / 0.5) ** 2, rel=1e-3)
    exact_lens = LensPrior(focal_sigma=0.0, k1_sigma=0.0)
    found = covariances(camera, theirs, ErrorModel(0.5, 1.0, exact_lens, 0.0))
    assert_same_covariances(found.poses, expected)
    of_points = [marginals.marginalCovariance(landmark_key(track)) for track in start.track_ids.tolist()]
    assert_same_covariances(found.points, np.array(of_points))
    newest = max(range(len(start.frames)), key=lambda k: start.frames[k])
    assert newest == len(start.frames) - 1
    for track in start.track_ids.tolist()[::20]:
        at = start.track_ids.tolist().index(track)
        assert_same_covariances(found.in_newest[at : at + 1], in_camera(marginals, values, start.frames[newest], track))


def in_camera(marginals, values, frame, track):
    """The covariance of a landmark in the frame of a camera, by gtsam's joint covariance and derivatives."""
    of_pose, of_point = np.zeros((3, 6), order="F"), np.zeros((3, 3), order="F")
    values.atPose3(pose_key(frame)).transformTo(values.atPoint3(landmark_key(track)), of_pose, of_point)
    joint = marginals.jointMarginalCovariance([landmark_key(track), pose_key(frame)])
    keys = (landmark_key(track), pose_key(frame))
    J = dict(zip(keys, (of_point, of_pose), strict=True))
    return np.sum([J[a] @ joint.at(a, b) @ J[b].T for a in keys for b in keys], axis=0)[None]


def assert_same_covariances(found, expected):
    """Within a hundredth of the standard deviations."""
    sigmas = np.sqrt(np.einsum("kii->ki", expected))
    units = sigmas[:, :, None] * sigmas[:, None, :]
    np.testing.assert_allclose(found / units, expected / units, atol=0.01)


@pytest.mark.parametrize("model", ["radtan", "fisheye"])
def test_the_robust_optimum_is_that_of_gtsam(model):
    """A tenth of the observations is off by 20 px."""
    rng = np.random.default_rng(10)
    exact = noisy_problem(model, rng)
    off = 20 * rng.normal(size=exact.pixels.shape) * (rng.random(len(exact.views)) < 0.1)[:, None]
    start = with_lenses(CAMERAS[model], replace(exact, pixels=exact.pixels + off))
    graph, values = optimum_of_gtsam(CAMERAS[model], start, robust=True)
    theirs = read_problem(values, start)
    ours, errors = minimize(start, 0.5, iterations=100, tolerance=1e-12, robust=True)
    assert 0.5 * len(start.views) * (errors[-1] / 0.5) ** 2 == pytest.approx(graph.error(values), rel=1e-3)
    for one, other in zip(ours.world_from_cam, theirs.world_from_cam, strict=True):
        assert rotation_angle(one.R.T @ other.R) < 3e-5
        assert np.linalg.norm(one.t - other.t) < 3e-5


# -- points that are fitted robustly to their rays, for poses that are known -----------------------


def off_points(camera, start, noise_px, expected):
    """Distances of the fitted points from others."""
    return np.linalg.norm(fit_points(with_lenses(camera, start), noise_px).points - expected.points, axis=1)


@pytest.mark.parametrize("model", ["radtan", "fisheye"])
def test_the_points_are_those_of_gtsam_where_its_poses_are_held(model):
    rng = np.random.default_rng(3)
    exact = problem(CAMERAS[model], cloud(rng), noise_px=0.5, rng=rng)
    moved = replace(exact, points=exact.points * rng.normal(1, 0.02, (len(exact.points), 1)))
    noisy = moved.keep(rng.random(len(exact.views)) < 0.8)
    _, values = optimum_of_gtsam(CAMERAS[model], noisy, robust=True, poses_held=True)
    off = off_points(CAMERAS[model], noisy, 0.5, read_problem(values, noisy))
    assert (np.quantile(off, [0.5, 0.95]) < [1e-4, 2e-3]).all()
