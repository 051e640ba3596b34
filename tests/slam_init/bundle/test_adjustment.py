"""Bundle adjustment on exact and noisy worlds: optimum, outliers, gauge, covariances, and failures as values."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from make_bundle import FOCAL, MAP, disturbed, kept_of, scale_of, with_outliers
from make_map import CAMERAS
from make_scene import CAMERA, cloud, problem

from quest.geometry.quaternion import rotation_angle
from slam_init.bundle.adjustment import adjust, restated
from slam_init.bundle.problem import BundleFailure, BundleSolution, PosePrior
from slam_init.types.pose import Pose


@pytest.mark.parametrize("model", ["pinhole", "radtan5", "fisheye"])
def test_exact_observations_leave_no_residual_and_give_the_true_poses(model):
    rng = np.random.default_rng(1)
    exact = problem(CAMERAS[model], cloud(rng))
    solution = adjust(CAMERAS[model], disturbed(exact, rng), MAP)
    assert isinstance(solution, BundleSolution)
    assert solution
    assert solution.rmse_px < 1e-3
    assert len(solution.problem.points) == 120
    scale = scale_of(solution, exact)
    for pose, true in zip(solution.problem.world_from_cam, exact.world_from_cam, strict=True):
        assert rotation_angle(pose.R.T @ true.R) < 1e-5
        np.testing.assert_allclose(pose.t, scale * true.t, atol=1e-5)
    np.testing.assert_allclose(solution.problem.points, scale * exact.points, atol=1e-4)


def test_outliers_are_removed_and_inliers_are_kept():
    rng = np.random.default_rng(3)
    noisy = problem(CAMERA, cloud(rng, 200), noise_px=0.3, rng=rng)
    wrong, outliers = with_outliers(noisy, 40, rng)
    solution = adjust(CAMERA, wrong, MAP)
    assert kept_of(solution, outliers) > 0.9 * (len(noisy.pixels) - 40)
    assert solution.noise_px == pytest.approx(0.3, rel=0.2)
    scale = scale_of(solution, noisy)
    for pose, true in zip(solution.problem.world_from_cam, noisy.world_from_cam, strict=True):
        assert rotation_angle(pose.R.T @ true.R) < np.deg2rad(0.3)
        assert np.linalg.norm(pose.t - scale * true.t) < 0.01


def test_the_gauge_is_the_first_camera_and_the_median_depth():
    rng = np.random.default_rng(4)
    noisy = problem(CAMERA, cloud(rng), noise_px=0.5, rng=rng).scaled(17.0)
    solution = adjust(CAMERA, noisy, MAP)
    first = solution.problem.world_from_cam[0]
    np.testing.assert_allclose(first.R, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(first.t, 0, atol=1e-6)
    assert np.median(solution.problem.points[:, 2]) == pytest.approx(1.0)
    assert solution.before.frames == solution.problem.frames
    assert np.array_equal(solution.before.track_ids, solution.problem.track_ids)
    np.testing.assert_allclose(solution.pose_covariances[0], 0, atol=1e-9)


def test_a_tight_prior_keeps_the_poses_and_a_loose_one_has_no_effect():
    """The poses start some pixels off, so that the landmarks and the prior contradict each other."""
    rng = np.random.default_rng(7)
    start = disturbed(problem(CAMERA, cloud(rng), noise_px=0.5, rng=rng), rng, 0.003, 0.001)
    free, tight, loose = (
        adjust(CAMERA, one, MAP)
        for one in (start, start.with_prior(PosePrior(1e-5, 1e-5)), start.with_prior(PosePrior(1.0, 1.0)))
    )
    assert tight.recipe.graph.size() == len(tight.problem.pixels) + 2 + len(start.frames) - 1
    for k in range(1, len(start.frames)):
        mean = start.world_from_cam[k].R
        assert rotation_angle(tight.problem.world_from_cam[k].R.T @ mean) < 1e-4
        assert rotation_angle(free.problem.world_from_cam[k].R.T @ mean) > 1e-3
        assert rotation_angle(free.problem.world_from_cam[k].R.T @ loose.problem.world_from_cam[k].R) < 1e-4
    assert np.trace(tight.pose_covariances[-1]) < np.trace(free.pose_covariances[-1])


def stretched():
    """A problem whose views are stretched, each by another amount, as of a wrong lens."""
    rng = np.random.default_rng(5)
    exact = problem(CAMERA, cloud(rng), noise_px=0.1, rng=rng)
    stretch = rng.normal(0, 0.004, (len(exact.frames), 2))[exact.views]
    return replace(exact, pixels=exact.pixels + stretch * (exact.pixels - (CAMERA.cx, CAMERA.cy)))


def test_errors_that_tracks_share_do_not_outweigh_a_prior_and_the_graph_is_at_its_optimum():
    """The stretch moves the poses of the tracks alone."""
    start = stretched()
    prior = PosePrior(5e-4, 5e-3)
    alone, both = (adjust(CAMERA, one, MAP, poses_known=True) for one in (start, start.with_prior(prior)))
    again = gtsam.LevenbergMarquardtOptimizer(both.recipe.graph, both.recipe.values).optimize()
    assert both.overdispersion > 2
    assert both.recipe.graph.error(again) == pytest.approx(both.recipe.graph.error(both.recipe.values), rel=1e-3)
    last = start.world_from_cam[-1].R
    from_prior = [rotation_angle(one.problem.world_from_cam[-1].R.T @ last) for one in (alone, both)]
    assert from_prior[1] < 0.5 * from_prior[0]


def test_held_poses_keep_the_covariance_of_what_is_known_of_them():
    """The tracks and the prior contradict each other as above; the poses are held by a tenth of the prior."""
    start = stretched()
    prior = PosePrior(5e-4, 5e-3)
    held = adjust(CAMERA, start.with_prior(prior.times(0.1)), MAP, poses_known=True)
    stated = restated(held, prior, MAP)
    assert stated.problem.world_from_cam == held.problem.world_from_cam
    np.testing.assert_array_equal(stated.problem.points, held.problem.points)
    assert stated.recipe.graph.size() == held.recipe.graph.size()
    assert (
        np.trace(stated.pose_covariances[1:], axis1=1, axis2=2) > np.trace(held.pose_covariances[1:], axis1=1, axis2=2)
    ).all()
    assert (stated.depth_sigmas >= held.depth_sigmas * (1 - 1e-9)).mean() > 0.9


def exact(count=120):
    return problem(CAMERA, cloud(np.random.default_rng(10), count))


def with_nan(values):
    return np.where(np.arange(len(values))[:, None] == 3, np.nan, values)


def unrelated_pixels():
    return np.random.default_rng(10).uniform((0, 0), (640, 480), exact().pixels.shape)


BAD = {
    "few points": lambda: exact(5),
    "a start that is no number": lambda: replace(exact(), points=with_nan(exact().points)),
    "a pixel that is no number": lambda: replace(exact(), pixels=with_nan(exact().pixels)),
    "a view without points": lambda: exact().keep(exact().views != 2),
    "unrelated pixels": lambda: replace(exact(), pixels=unrelated_pixels()),
    "all behind": lambda: replace(exact(), points=-exact().points),
    "no baseline": lambda: problem(CAMERA, cloud(np.random.default_rng(10)), [Pose.identity()] * 3),
}


@pytest.mark.parametrize("config", [MAP, FOCAL], ids=["held", "adjusted"])
@pytest.mark.parametrize("bad", BAD)
def test_a_problem_that_cannot_be_solved_is_a_failure_with_its_cause(bad, config):
    start = BAD[bad]()
    failure = adjust(CAMERA, start, config)
    assert isinstance(failure, BundleFailure)
    assert not failure
    assert failure.cause
    assert "\n" not in failure.cause
    assert failure.frame == (start.frames[2] if bad == "a view without points" else None)
