"""Least squares without gtsam: its equations, optimum and covariances are those of gtsam's graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from make_bundle import disturbed, read_problem, with_kernel
from make_map import CAMERAS
from make_scene import CAMERA, cloud, problem

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.bundle.covariances import LENS, SharedErrors, covariances
from slam_init.bundle.graph import PoseTerms, build_graph, landmark_key, pose_key
from slam_init.bundle.kernel import eliminate_points, errors_of_points
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.problem import PosePrior
from slam_init.types.pose import Pose

PRIOR = PosePrior(1e-3, 1e-2)


def noisy_problem(model, rng, prior=None, share=0.8):
    """Noise of half a pixel; some observations are missing, so that the points differ in their views."""
    exact = problem(CAMERAS[model], cloud(rng), noise_px=0.5, rng=rng)
    start = disturbed(exact, rng).keep(rng.random(len(exact.views)) < share)
    return with_lenses(CAMERAS[model], start if prior is None else start.with_prior(prior))


def optimum_of_gtsam(camera, start, robust=False):
    """gtsam's graph of a problem, and its optimum."""
    graph, values = build_graph(camera, start, 0.5)
    if robust:
        graph = with_kernel(graph, len(start.views))
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
    exact_lens = SharedErrors.of_lens(np.zeros((len(theirs.pixels), 2, LENS)))
    found = covariances(theirs, 0.5, exact_lens)
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


def arrays(start):
    """Poses, points and observations by landmark, as the compiled loops take them."""
    order = np.argsort(start.landmarks, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(start.landmarks, minlength=len(start.points)))])
    R, t = (np.array([getattr(pose, name) for pose in start.world_from_cam]) for name in "Rt")
    return R, t, np.ascontiguousarray(start.points), starts, start.views[order], start.lenses[order]


def moved(R, t, points, step):
    """Poses and points after a step of all unknowns, in the tangent of the kernel."""
    count = 6 * len(R)
    turns, shifts = np.split(step[:count].reshape(-1, 6), 2, axis=1)
    return R @ rotation_from_vector(turns), t + np.einsum("kij,kj->ki", R, shifts), points + step[count:].reshape(-1, 3)


def test_the_equations_are_the_derivatives_of_the_error():
    """The gradient by differences; and a step of the eliminated system solves the whole one."""
    start = noisy_problem("radtan", np.random.default_rng(4))
    start = start.keep(start.landmarks < 12)
    R, t, points, *observed = arrays(start)
    count = len(points)
    _, gradient, roots, solved, _ = eliminate_points(R, t, points, *observed, 0.0, np.inf, False)
    C = np.zeros((count, 3, 3))
    rows, columns = (0, 1, 2, 1, 2, 2), (0, 1, 2, 0, 0, 1)
    C[:, rows, columns] = roots
    whole = np.concatenate([gradient, np.einsum("lij,lj->li", C, solved.reshape(-1, 3)).ravel()])

    def error(step):
        return 0.5 * errors_of_points(*moved(R, t, points, step), *observed, np.inf).sum()

    h = 1e-6
    numeric = [(error(h * unit) - error(-h * unit)) / (2 * h) for unit in np.eye(len(whole))]
    np.testing.assert_allclose(whole, numeric, rtol=1e-4, atol=1e-4 * np.abs(whole).max())


def test_a_point_without_a_ray_in_any_view_changes_nothing():
    start = noisy_problem("pinhole", np.random.default_rng(5), share=2.0)
    lenses = start.lenses.copy()
    lenses[start.landmarks == 3] = np.nan
    found, _ = minimize(replace(start, lenses=lenses), 0.5, iterations=10, tolerance=1e-9)
    rest, _ = minimize(start.keep(start.landmarks != 3), 0.5, iterations=10, tolerance=1e-9)
    assert np.array_equal(found.points[3], start.points[3])
    np.testing.assert_allclose(np.delete(found.points, 3, axis=0), rest.points, rtol=1e-9)


def test_a_start_behind_a_camera_is_told():
    start = with_lenses(CAMERA, problem(CAMERA, cloud(np.random.default_rng(6))))
    with pytest.raises(RuntimeError, match="behind"):
        minimize(replace(start, points=-start.points), 0.5, iterations=5, tolerance=1e-5)


def test_without_virtual_cameras_the_caller_is_told():
    with pytest.raises(ValueError, match="lenses"):
        minimize(problem(CAMERA, cloud(np.random.default_rng(7))), 0.5, iterations=5, tolerance=1e-5)


def test_the_terms_of_the_poses_have_their_equations_in_the_order_of_the_views():
    """The keys of gtsam are sorted by frame, the views of a problem need not be."""
    exact = problem(CAMERA, cloud(np.random.default_rng(8)))
    start = replace(exact, frames=(40, 3, 20, 10)).with_prior(PRIOR)
    R, t = (np.array([getattr(pose, name) for pose in start.world_from_cam]) for name in "Rt")
    terms, rng = PoseTerms(start), np.random.default_rng(9)
    step = 1e-4 * rng.normal(size=6 * len(R))
    at = moved(R, t, np.zeros((0, 3)), step)[:2]
    information, gradient = terms.equations(*at)
    unit = 1e-7 * rng.normal(size=len(step))
    ahead, behind = (terms.error(*moved(*at, np.zeros((0, 3)), sign * unit)[:2]) for sign in (1, -1))
    assert gradient @ unit == pytest.approx(0.5 * (ahead - behind), rel=1e-3)
    assert np.linalg.eigvalsh(information).min() > -1e-6 * np.abs(information).max()
    assert terms.error(R, t) == pytest.approx(0.0, abs=1e-12)
    assert isinstance(start.world_from_cam[0], Pose)
