"""Laws of the covariances of a map: they cover lenses and errors that tracks share, and nothing else changes them."""

from dataclasses import replace
from math import comb

import gtsam
import numpy as np
import pytest
from make_bundle import MAP, ROTATING, SIDEWAYS
from make_map import CAMERAS
from make_scene import CAMERA, cloud, problem, with_random_lens

from slam_init.bundle.adjustment import adjust
from slam_init.bundle.covariances import ErrorModel, at_projections, covariances, lens_prior
from slam_init.bundle.graph import landmark_key, pose_key
from slam_init.bundle.least_squares import with_lenses
from slam_init.bundle.reprojection import calibration_key
from slam_init.bundle.shared_errors import error_model
from slam_init.types.pose import Pose

LENS = replace(MAP, lens_uncertainty=1.0)
#: Quantiles of chi-square at 95 % with 3, 5 and 6 degrees of freedom.
CHI95 = {3: 7.815, 5: 11.070, 6: 12.592}


def fitted(camera, points, poses, rng, noise_px=0.3, config=LENS, shift=None):
    """Adjusted map of points; ``shift`` moves all pixels of a view."""
    exact = problem(camera, points, list(poses), noise_px, rng)
    if shift is not None:
        exact = replace(exact, pixels=exact.pixels + shift[exact.views])
    return exact, adjust(camera, exact, config, poses_known=True)


def inside(exact, solution, true_poses, true_points):
    """Whether poses and points (one each, of the last pose and of the first point) lie in their 95 % ellipsoids."""
    found = solution.problem.world_from_cam
    scale = np.linalg.norm(found[-1].t - found[0].t) / np.linalg.norm(true_poses[-1].t - true_poses[0].t)
    start = true_poses[0].inverse()
    moved = found[-1].inverse() @ (lambda pose: Pose(pose.R, scale * pose.t))(start @ true_poses[-1])
    error = gtsam.Pose3.Logmap(gtsam.Pose3(gtsam.Rot3(moved.R), moved.t))
    pose = error @ np.linalg.solve(solution.pose_covariances[-1], error) < CHI95[5]
    rows = np.searchsorted(exact.track_ids, solution.problem.track_ids)
    off = scale * start.apply(true_points[rows]) - solution.problem.points
    squares = np.einsum("li,li->l", off, np.linalg.solve(solution.point_covariances, off[..., None])[..., 0])
    return pose, squares[0] < CHI95[3]


def at_least(successes, trials, probability=0.95, chance=1e-3):
    """Whether so few successes happen by chance more often than ``chance``, with at least this probability of each."""
    tail = sum(comb(trials, k) * probability**k * (1 - probability) ** (trials - k) for k in range(successes + 1))
    return tail > chance


def test_a_lens_that_is_off_as_much_as_its_prior_says_is_covered():
    """40 random lenses (seeds 0 to 39), with exact binomial bounds."""
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        true = with_random_lens(CAMERA, lens_prior(CAMERA, LENS).sigmas, rng)
        cloud_ = cloud(rng, 80)
        seen = problem(true, cloud_, ROTATING, 0.3, rng)
        solution = adjust(CAMERA, seen, LENS, poses_known=True)
        if solution:
            found.append(inside(seen, solution, ROTATING, cloud_))
    assert len(found) >= 36
    for covered in np.sum(found, axis=0).tolist():
        assert at_least(covered, len(found))


def test_a_shift_of_each_view_is_covered():
    """A stabilizer moves all pixels of a view by a tenth of a pixel (40 draws): no residual of a rotation shows it."""
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        cloud_ = cloud(rng, 150)
        shift = 0.1 * rng.normal(size=(len(ROTATING), 2))
        seen, solution = fitted(CAMERA, cloud_, ROTATING, rng, 0.3, MAP, shift)
        found.append(inside(seen, solution, ROTATING, cloud_))
    for covered in np.sum(found, axis=0).tolist():
        assert at_least(covered, 40)


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
def test_the_graph_has_the_covariances_of_its_noise_and_its_lens(model):
    """The marginals of gtsam are the covariances without fields, with the noise of the graph, and a fitted lens."""
    camera, rng = CAMERAS[model], np.random.default_rng(4)
    _, solution = fitted(camera, cloud(rng, 60), ROTATING, rng)
    measured = with_lenses(camera, solution.problem)
    projected, noise_px = at_projections(camera, measured), solution.noise_px
    errors = error_model(camera, projected, measured, noise_px, lens_prior(camera, LENS))
    lens = replace(errors.lens, fitted=4 * (True,))
    without_fields = ErrorModel(noise_px, solution.overdispersion, lens, 0.0)
    found = covariances(camera, projected, without_fields)
    marginals = gtsam.Marginals(solution.recipe.graph, solution.recipe.values)
    expected = np.array([marginals.marginalCovariance(pose_key(frame)) for frame in measured.frames])
    assert_same(found.poses, expected)
    tracks = measured.track_ids[::10].tolist()
    of_points = np.array([marginals.marginalCovariance(landmark_key(track)) for track in tracks])
    assert_same(found.points[::10], of_points)
    if model == "pinhole":
        of_lens = marginals.marginalCovariance(calibration_key())[np.ix_([0, 3, 4, 5], [0, 3, 4, 5])]
        units = np.array([camera.fx, 1.0, 1.0, 1.0])
        assert_same((units[:, None] * found.lens * units)[None], of_lens[None])


def assert_same(found, expected):
    """Within a fiftieth of the standard deviations."""
    sigmas = np.sqrt(np.einsum("kii->ki", expected))
    units = sigmas[:, :, None] * sigmas[:, None, :]
    np.testing.assert_allclose(found / units, expected / units, atol=0.02)


def unit_of(solution, true_points, tracks):
    """The mean logarithm of the distances from the newest camera over the true ones, by their weights."""
    world_from_cam = solution.problem.world_from_cam
    span = np.linalg.norm(world_from_cam[-1].t - world_from_cam[0].t)
    distances = np.linalg.norm(solution.problem.points - world_from_cam[-1].t, axis=1) / span
    rows = np.searchsorted(tracks, solution.problem.track_ids)
    true = np.linalg.norm(true_points[rows] - ROTATING[-1].t, axis=1) / np.linalg.norm(ROTATING[-1].t - ROTATING[0].t)
    weights = 1 / solution.depth_sigmas**2
    return float(weights @ np.log(distances / true) / weights.sum())


@pytest.mark.parametrize("parameter", range(4))
def test_each_error_of_the_lens_moves_the_unit_as_the_map_states(parameter):
    """A lens off by a tenth of a deviation of one parameter, seen without noise."""
    rng, sigmas = np.random.default_rng(8), lens_prior(CAMERA, LENS).sigmas
    off = 0.1 * sigmas * (np.arange(4) == parameter)
    true = replace(CAMERA.refocused(off[0], off[3]), cx=CAMERA.cx + off[1], cy=CAMERA.cy + off[2])
    points = cloud(rng, 80)
    units = []
    for camera in (CAMERA, true):
        seen = problem(camera, points, ROTATING, 1e-3, rng)
        solution = adjust(CAMERA, seen, replace(LENS, min_noise_px=1e-3), poses_known=True)
        units.append(unit_of(solution, points, seen.track_ids))
    stated = solution.scale_uncertainty.by_lens
    # The lens of the map is short by what the true one is off, and the prior of k1 has units of its own.
    assert units[1] - units[0] == pytest.approx(-0.1 * stated[parameter], abs=0.1 * 0.15 * np.abs(stated).max())


def test_an_exact_lens_is_held_and_a_tight_prior_gives_the_same():
    rng = np.random.default_rng(5)
    seen = problem(CAMERA, cloud(rng), ROTATING, 0.3, rng)
    held, tight, wide = (
        adjust(CAMERA, seen, replace(MAP, lens_uncertainty=share), poses_known=True) for share in (0.0, 1e-4, 1.0)
    )
    assert not held.recipe.values.exists(calibration_key())
    assert tight.recipe.values.exists(calibration_key())
    for solution in (tight, wide):
        assert np.array_equal(solution.problem.points, held.problem.points)  # the lens stays as stated
    np.testing.assert_allclose(tight.pose_covariances, held.pose_covariances, rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(tight.point_covariances, held.point_covariances, rtol=1e-3, atol=1e-9)
    assert (np.linalg.eigvalsh(wide.point_covariances - held.point_covariances) > -1e-9).all()
    np.testing.assert_allclose(wide.seen_covariances, held.seen_covariances, rtol=0.05, atol=1e-6)


def test_a_landmark_with_two_views_that_decides_about_the_poses_is_left_out():
    """An outlier that lies near its epipolar line, with a large parallax, in a map of far points."""
    rng = np.random.default_rng(9)
    points = cloud(rng, 120)
    points[:, 2] += 12.0
    points[:, :2] *= 6.0
    points[7] = [0.1, 0.0, 1.2]
    pair = [Pose(np.eye(3), np.zeros(3)), Pose(np.eye(3), np.array([0.3, 0.0, 0.0]))]
    seen = problem(CAMERA, points, pair, 0.3, rng)
    pixels = seen.pixels + np.where((seen.landmarks == 7) & (seen.views == 1), 1.5, 0.0)[:, None] * [0.0, 1.0]
    loose = replace(MAP, max_depth_sigma=5.0)
    solution = adjust(CAMERA, replace(seen, pixels=pixels), loose, poses_known=True)
    assert seen.track_ids[7] not in solution.problem.track_ids
    assert len(solution.problem.track_ids) > 100


@pytest.mark.parametrize(("seed", "left"), [(0, 6), (1, 6), (2, 7)])
def test_a_view_of_few_landmarks_has_a_covariance(seed, left):
    """Of 600 landmarks 200 are chosen for the errors that they share, which could leave a view without any."""
    rng = np.random.default_rng(seed)
    exact = problem(CAMERA, cloud(rng, 600), list(SIDEWAYS), 0.3, rng)
    of_last = np.flatnonzero(exact.views == exact.views.max())
    kept = np.ones(len(exact.views), bool)
    kept[rng.permutation(of_last)[left:]] = False
    solution = adjust(CAMERA, exact.keep(kept), LENS, poses_known=True)
    assert np.isfinite(solution.pose_covariances).all()
    assert (np.linalg.eigvalsh(solution.pose_covariances[1:]) > -1e-12).all()
    assert np.trace(solution.pose_covariances[-1]) > np.trace(solution.pose_covariances[1])
