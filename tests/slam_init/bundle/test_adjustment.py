"""Bundle adjustment: laws on exact and noisy worlds, its gauge, its covariances, and failures as values."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS, make_poses
from make_scene import CAMERA, CONFIG, between, cloud, plane, problem

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.bundle import adjustment as bundle
from slam_init.bundle import focal as focal_adjustment
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.bundle.graph import calibration_key, gtsam_calibration, measured_pixels
from slam_init.bundle.problem import BundleFailure, BundleSolution
from slam_init.types.pose import Pose

MAP = CONFIG.map
FOCAL = replace(MAP, refine_focal=True)
#: 20 degrees in five views, as far as the camera goes to the side.
TURNING = [
    Pose(rotation_from_vector(np.array([0.02, -0.08, 0.03]) * i), np.array([0.1 * i, 0.01 * i * i, 0.03 * i]))
    for i in range(5)
]
SIDEWAYS = [Pose(np.eye(3), np.array([0.08 * i, 0.0, 0.0])) for i in range(5)]


def disturbed(exact, rng, angle_rad=0.0003, length=0.0003):
    """The same observations, other poses and points to start from; the first pose stays the world."""
    poses = [exact.world_from_cam[0]] + [
        Pose(pose.R @ rotation_from_vector(rng.normal(0, angle_rad, 3)), pose.t + rng.normal(0, length, 3))
        for pose in exact.world_from_cam[1:]
    ]
    return replace(
        exact, world_from_cam=tuple(poses), points=exact.points * rng.normal(1, 0.02, (len(exact.points), 1))
    )


def scale_of(solution, exact):
    """The map's unit: adjusted over true distance of the last camera."""
    return np.linalg.norm(solution.problem.world_from_cam[-1].t) / np.linalg.norm(exact.world_from_cam[-1].t)


@pytest.mark.parametrize("model", CAMERAS)
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


def test_starts_that_are_off_by_several_pixels_end_in_the_same_optimum():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        solution = adjust(CAMERA, disturbed(problem(CAMERA, cloud(rng)), rng, 0.005, 0.005), MAP)
        assert isinstance(solution, BundleSolution)
        assert solution.rmse_px < 1e-3


@pytest.mark.parametrize("noise_px", [0.3, 1.0])
def test_the_noise_is_estimated_whatever_was_assumed(noise_px):
    rng = np.random.default_rng(2)
    solution = adjust(CAMERA, problem(CAMERA, cloud(rng, 300), noise_px=noise_px, rng=rng), MAP)
    assert solution.noise_px == pytest.approx(noise_px, rel=0.15)


def test_outliers_are_removed_and_the_rest_is_kept():
    rng = np.random.default_rng(3)
    noisy = problem(CAMERA, cloud(rng, 200), noise_px=0.3, rng=rng)
    wrong = rng.choice(len(noisy.pixels), 40, replace=False)
    pixels = noisy.pixels.copy()
    pixels[wrong] += rng.choice([-1, 1], (40, 2)) * rng.uniform(8, 40, (40, 2))
    solution = adjust(CAMERA, replace(noisy, pixels=pixels), MAP)
    kept = {tuple(pixel) for pixel in solution.problem.pixels}
    assert not any(tuple(pixel) in kept for pixel in pixels[wrong])
    assert len(kept) > 0.9 * (len(pixels) - 40)
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


def test_the_unit_of_length_of_the_start_does_not_matter():
    rng = np.random.default_rng(5)
    noisy = problem(CAMERA, cloud(rng), noise_px=0.5, rng=rng)
    a, b = adjust(CAMERA, noisy, MAP), adjust(CAMERA, noisy.scaled(1e3), MAP)
    np.testing.assert_allclose(a.problem.points, b.problem.points, rtol=1e-6)
    np.testing.assert_allclose(a.pose_covariances, b.pose_covariances, rtol=1e-3, atol=1e-12)


def test_the_graph_is_at_its_optimum_and_has_a_factor_for_each_observation():
    import gtsam

    rng = np.random.default_rng(6)
    solution = adjust(CAMERA, problem(CAMERA, cloud(rng), noise_px=0.5, rng=rng), MAP)
    assert solution.graph.size() == len(solution.problem.pixels) + 2  # prior and range
    again = gtsam.LevenbergMarquardtOptimizer(solution.graph, solution.values).optimize()
    assert solution.graph.error(again) == pytest.approx(solution.graph.error(solution.values), rel=1e-3)
    assert solution.errors[-1] <= solution.errors[0]


def test_covariances_are_the_scatter_of_many_runs():
    """Monte Carlo: the scatter of the adjusted poses over the noise is what the covariance says it is."""
    rng = np.random.default_rng(7)
    points = cloud(rng, 60)
    exact = problem(CAMERA, points, make_poses(3))
    whitened = []
    for _ in range(60):
        noisy = replace(exact, pixels=exact.pixels + rng.normal(0, 0.5, exact.pixels.shape))
        solution = adjust(CAMERA, noisy, MAP)
        # The gauge holds the longest baseline: bring the truth to it.
        truth = exact.scaled(scale_of(solution, exact))
        error = between(truth.world_from_cam[1], solution.problem.world_from_cam[1])
        angle = (
            np.array([error.R[2, 1] - error.R[1, 2], error.R[0, 2] - error.R[2, 0], error.R[1, 0] - error.R[0, 1]]) / 2
        )
        tangent = np.concatenate([angle, error.t])
        whitened.append(tangent @ np.linalg.solve(solution.pose_covariances[1], tangent))
    # Chi-squared with 6 degrees of freedom: mean 6, standard deviation of the mean of 60 is 0.45.
    assert 4.0 < np.mean(whitened) < 9.0


def test_parallax_is_the_largest_angle_between_two_rays():
    poses = tuple(Pose(np.eye(3), np.array([x, 0, 0])) for x in (0.0, 0.1, -0.1))
    found = problem(CAMERA, np.array([[0.0, 0, 1.0]]), poses).parallax_rad()
    np.testing.assert_allclose(found, 2 * np.arctan(0.1))


def test_a_landmark_without_a_second_view_is_dropped():
    exact = problem(CAMERA, cloud(np.random.default_rng(8), 30))
    chosen = (exact.landmarks != 5) | (exact.views == 0)
    kept = exact.keep(chosen)
    assert 15 not in kept.track_ids  # the id of point 5
    assert len(kept.points) == 29
    assert np.abs(kept.residuals(CAMERA)).max() < 1e-9


def test_a_point_behind_the_camera_has_no_residual_and_does_not_stay():
    rng = np.random.default_rng(9)
    exact = problem(CAMERA, cloud(rng))
    points = exact.points.copy()
    points[0, 2] *= -1
    turned = replace(exact, points=points)
    assert np.isnan(turned.residuals(CAMERA)[turned.landmarks == 0]).all()
    solution = adjust(CAMERA, turned, MAP)
    assert isinstance(solution, BundleSolution)
    assert (solution.problem.points[:, 2] > 0).all()
    assert np.isfinite(solution.problem.residuals(CAMERA)).all()


def few_points():
    return problem(CAMERA, cloud(np.random.default_rng(10), 5))


def nan_start():
    exact = problem(CAMERA, cloud(np.random.default_rng(10)))
    points = exact.points.copy()
    points[3] = np.nan
    return replace(exact, points=points)


def nan_pixel():
    exact = problem(CAMERA, cloud(np.random.default_rng(10)))
    pixels = exact.pixels.copy()
    pixels[3] = np.nan
    return replace(exact, pixels=pixels)


def view_without_points():
    exact = problem(CAMERA, cloud(np.random.default_rng(10)))
    chosen = exact.views != 2
    return replace(exact, views=exact.views[chosen], landmarks=exact.landmarks[chosen], pixels=exact.pixels[chosen])


def unrelated_pixels():
    rng = np.random.default_rng(10)
    exact = problem(CAMERA, cloud(rng))
    return replace(exact, pixels=rng.uniform((0, 0), (640, 480), exact.pixels.shape))


def all_behind():
    exact = problem(CAMERA, cloud(np.random.default_rng(10)))
    return replace(exact, points=-exact.points)


def no_baseline():
    return problem(CAMERA, cloud(np.random.default_rng(10)), [Pose.identity()] * 3)


@pytest.mark.parametrize("config", [MAP, FOCAL], ids=["held", "adjusted"])
@pytest.mark.parametrize(
    "bad", [few_points, nan_start, nan_pixel, view_without_points, unrelated_pixels, all_behind, no_baseline]
)
def test_what_cannot_be_adjusted_is_a_failure_with_its_cause(bad, config):
    failure = adjust(CAMERA, bad(), config)
    assert isinstance(failure, BundleFailure)
    assert not failure
    assert failure.cause
    assert "\n" not in failure.cause


@pytest.mark.parametrize("model", CAMERAS)
def test_gtsam_projects_as_the_camera_does(model):
    import gtsam

    camera, points = CAMERAS[model], cloud(np.random.default_rng(11), 40)
    pixels = measured_pixels(camera, camera.project(points))
    calibration = gtsam_calibration(camera)
    uncalibrated = np.array([calibration.uncalibrate(point[:2] / point[2]) for point in points])
    assert not isinstance(calibration, gtsam.Cal3_S2) or model in ("pinhole", "radtan5")
    np.testing.assert_allclose(uncalibrated, pixels, atol=1e-6)


# -- the focal length --------------------------------------------------------------------------------


def map_errors(solution, exact):
    """Of a map in the truth's scale: rotation (degrees), direction of the baselines (degrees), median of the points."""
    scale = scale_of(solution, exact)
    pairs = list(zip(solution.problem.world_from_cam, exact.world_from_cam, strict=True))
    rotation = max(rotation_angle(pose.R.T @ true.R) for pose, true in pairs)
    cosines = [pose.t @ true.t / np.linalg.norm(pose.t) / np.linalg.norm(true.t) for pose, true in pairs[1:]]
    points = exact.points[solution.problem.track_ids // 3]
    return (
        np.degrees(rotation),
        np.degrees(np.arccos(min(1.0, *cosines))),
        np.median(np.linalg.norm(solution.problem.points - scale * points, axis=1)),
    )


@pytest.mark.parametrize("model", CAMERAS)
def test_exact_observations_give_the_true_focal_length(model):
    rng = np.random.default_rng(1)
    exact = problem(CAMERAS[model], cloud(rng), TURNING)
    stated = camera_with_focal_factor(CAMERAS[model], 1.05)
    held, adjusted = (adjust(stated, disturbed(exact, rng), config) for config in (MAP, FOCAL))
    # The prior pulls by the square of sigma over 0.05 of the twentieth, since no noise under 0.1 px is believed.
    assert adjusted.focal_factor_sigma < 0.008
    assert adjusted.focal_factor * 1.05 == pytest.approx(1, abs=1.2 * adjusted.focal_factor_sigma**2 / 0.05)
    assert adjusted.camera.fx == pytest.approx(CAMERAS[model].fx, rel=2e-3)
    for found, before in zip(map_errors(adjusted, exact), map_errors(held, exact), strict=True):
        assert found < 0.05 * before


@pytest.mark.parametrize("model", CAMERAS)
def test_a_focal_length_off_by_a_twentieth_is_found_where_the_camera_turns(model):
    """With noise of a fifth of a pixel, by the median of four worlds: half of the errors at most.

    All but that of the baselines' direction, which such noise alone turns by half a degree: it is no worse than that.
    """
    stated = camera_with_focal_factor(CAMERAS[model], 1.05)
    off, errors = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noisy = problem(CAMERAS[model], cloud(rng), TURNING, 0.2, rng)
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
def test_a_camera_that_goes_sideways_without_turning_cannot_tell_its_focal_length(scene):
    """Stretched along the optical axis the scene looks the same to a longer lens: the prior is all there is."""
    rng = np.random.default_rng(2)
    noisy = problem(CAMERA, scene(rng), SIDEWAYS, 0.5, rng)
    solution = adjust(camera_with_focal_factor(CAMERA, 1.05), noisy, FOCAL)
    assert 0.95 * FOCAL.focal_sigma < solution.focal_factor_sigma <= 1.001 * FOCAL.focal_sigma
    assert abs(solution.focal_factor - 1) < 0.02
    narrow = adjust(CAMERA, noisy, replace(FOCAL, focal_sigma=0.01))
    assert narrow.focal_factor_sigma == pytest.approx(0.01, rel=0.05)


def test_held_as_stated_it_is_no_variable():
    rng = np.random.default_rng(3)
    solution = adjust(CAMERA, problem(CAMERA, cloud(rng), TURNING, 0.5, rng), MAP)
    assert solution.camera is CAMERA
    assert (solution.focal_factor, solution.focal_factor_sigma) == (1.0, None)
    assert not solution.values.exists(calibration_key())


@pytest.mark.parametrize("model", CAMERAS)
def test_a_prior_that_leaves_no_freedom_is_the_stated_camera(model):
    rng = np.random.default_rng(4)
    noisy = problem(CAMERAS[model], cloud(rng), TURNING, 0.5, rng)
    held, adjusted = (adjust(CAMERAS[model], noisy, c) for c in (MAP, replace(FOCAL, focal_sigma=1e-7)))
    assert adjusted.focal_factor == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(adjusted.problem.points, held.problem.points, atol=1e-4)
    np.testing.assert_allclose(adjusted.pose_covariances, held.pose_covariances, rtol=0.02, atol=1e-9)


@pytest.mark.parametrize("model", CAMERAS)
def test_the_graph_with_the_calibration_is_at_its_optimum_and_holds_all_else(model):
    import gtsam

    rng = np.random.default_rng(6)
    noisy = problem(CAMERAS[model], cloud(rng), TURNING, 0.5, rng)
    stated = camera_with_focal_factor(CAMERAS[model], 1.05)
    solution = adjust(stated, noisy, FOCAL)
    assert solution.graph.size() == len(solution.problem.pixels) + 3  # priors of pose and calibration, range
    at = getattr(solution.values, f"at{type(gtsam_calibration(stated)).__name__}")
    np.testing.assert_allclose(at(calibration_key()).vector(), gtsam_calibration(solution.camera).vector())
    again = gtsam.LevenbergMarquardtOptimizer(solution.graph, solution.values).optimize()
    assert solution.graph.error(again) == pytest.approx(solution.graph.error(solution.values), rel=1e-3)
    moved = getattr(again, f"at{type(gtsam_calibration(stated)).__name__}")(calibration_key()).vector()
    vector = gtsam_calibration(solution.camera).vector()
    assert abs(moved[0] / vector[0] - 1) < 0.1 * solution.focal_factor_sigma
    np.testing.assert_allclose(moved[:2] / moved[0], vector[:2] / vector[0], rtol=1e-4)
    np.testing.assert_allclose(moved[2:], vector[2:], atol=1e-6)


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
def test_gtsam_projects_with_the_adjusted_camera_as_we_do(model):
    rng = np.random.default_rng(6)
    noisy = problem(CAMERAS[model], cloud(rng), TURNING, 0.5, rng)
    solution = adjust(camera_with_focal_factor(CAMERAS[model], 1.05), noisy, FOCAL)
    residuals = solution.problem.residuals(solution.camera)
    theirs = [solution.graph.at(i).error(solution.values) for i in range(len(residuals))]
    np.testing.assert_allclose(theirs, 0.5 * np.sum(residuals**2, axis=1) / solution.noise_px**2, rtol=1e-6)


def test_its_standard_deviation_is_the_scatter_of_many_runs():
    """Monte Carlo: true focal lengths drawn from the prior lie about the adjusted ones as the figure says."""
    rng = np.random.default_rng(7)
    exact = problem(CAMERA, cloud(rng, 50), TURNING)
    scores = []
    for _ in range(20):
        factor = rng.normal(1, FOCAL.focal_sigma)  # the true one over the stated one
        noisy = replace(exact, pixels=exact.pixels + rng.normal(0, 0.5, exact.pixels.shape))
        solution = adjust(camera_with_focal_factor(CAMERA, 1 / factor), noisy, FOCAL)
        scores.append((solution.focal_factor - factor) / solution.focal_factor_sigma)
    # Chi-squared with 20 degrees of freedom: mean 1, standard deviation 0.32.
    assert 0.3 < np.mean(np.square(scores)) < 2.2


def test_observations_that_a_wrong_focal_length_made_outliers_come_back():
    """A fifth off, and noise of a fifth of a pixel: some of what is right looks wrong until the focal length is."""
    rng = np.random.default_rng(8)
    noisy = problem(CAMERA, cloud(rng, 150), TURNING, 0.2, rng)
    wrong = rng.choice(len(noisy.pixels), 60, replace=False)
    pixels = noisy.pixels.copy()
    pixels[wrong] += rng.choice([-1, 1], (60, 2)) * rng.uniform(8, 40, (60, 2))
    stated = camera_with_focal_factor(CAMERA, 1.2)
    held, adjusted = (adjust(stated, replace(noisy, pixels=pixels), config) for config in (MAP, FOCAL))
    assert adjusted.focal_factor * 1.2 == pytest.approx(1, abs=0.02)
    assert adjusted.noise_px == pytest.approx(0.2, rel=0.15)
    kept = {tuple(pixel) for pixel in adjusted.problem.pixels}
    assert not any(tuple(pixel) in kept for pixel in pixels[wrong])
    assert len(held.problem.pixels) < len(kept) > 0.99 * (len(pixels) - 60)


def test_a_point_behind_the_camera_is_told_to_nobody(capfd):
    rng = np.random.default_rng(9)
    exact = problem(CAMERA, cloud(rng), TURNING)
    points = exact.points.copy()
    points[:5, 2] *= -1
    solution = adjust(CAMERA, replace(exact, points=points), FOCAL)
    assert isinstance(solution, BundleSolution)
    assert (solution.problem.points[:, 2] > 0).all()
    assert capfd.readouterr() == ("", "")


def test_a_longer_lens_with_k3_bends_the_image_as_before():
    """Undistorted pixels are what such a camera is adjusted on: the factor only scales what they mean."""
    camera, pixels = CAMERAS["radtan5"], np.random.default_rng(0).uniform((0, 0), (640, 480), (50, 2))
    longer = camera_with_focal_factor(camera, 1.07)
    np.testing.assert_allclose(measured_pixels(longer, pixels), measured_pixels(camera, pixels), atol=1e-9)
    np.testing.assert_allclose(1.07 * longer.normalize(pixels), camera.normalize(pixels), atol=1e-12)


def failing_from(call, count):
    """A function that fails as gtsam does from some call on."""
    calls = []

    def wrapped(*args, **kwargs):
        calls.append(args)
        if len(calls) >= count:
            raise RuntimeError("Indeterminant linear system")
        return call(*args, **kwargs)

    return wrapped


def test_a_round_of_the_focal_length_that_fails_leaves_the_last_one(monkeypatch):
    rng = np.random.default_rng(0)
    noisy = problem(CAMERA, cloud(rng), TURNING, 0.2, rng)
    stated = camera_with_focal_factor(CAMERA, 1.05)
    monkeypatch.setattr(bundle, "_fit", failing_from(bundle._fit, 2))
    solution = adjust(stated, noisy, FOCAL)
    assert isinstance(solution, BundleSolution)
    assert solution.focal_factor < 0.99  # of the one step before


def test_steps_of_the_focal_length_that_fail_leave_the_stated_one(monkeypatch):
    rng = np.random.default_rng(0)
    noisy = problem(CAMERA, cloud(rng), TURNING, 0.2, rng)
    monkeypatch.setattr(focal_adjustment, "optimize", failing_from(focal_adjustment.optimize, 1))
    solution = adjust(CAMERA, noisy, FOCAL)
    assert isinstance(solution, BundleSolution)
    assert solution.focal_factor == 1


def test_no_landmarks_have_no_parallax():
    rng = np.random.default_rng(0)
    exact = problem(CAMERA, cloud(rng), SIDEWAYS, 0.0, rng)
    assert exact.keep(np.zeros(len(exact.views), bool)).parallax_rad().shape == (0,)
