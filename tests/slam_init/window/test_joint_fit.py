"""Laws of the joint fit: exact data give the truth, noisy data a cost and an uncertainty that can be believed."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS
from make_window import PRIORS, camera_of, focal_sigma, make_window

from sequences_synth.points import make_points
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.window.joint_fit import Priors, fit_window, start_at, with_error_fields
from slam_init.window.risk import direction_sigmas_deg
from slam_init.window.tracks import WindowTracks

SCENES = {"general": "room", "plane": "wall"}
#: No observation is an outlier.
WIDE = replace(PRIORS, gate_sigmas=1e3)


def fitted(window, priors=PRIORS, kind="general", seed=0, tolerance=1e-10):
    """The fit from a start near the truth."""
    plane = 1.03 * window.plane if kind == "plane" else None
    return fit_window(window.tracks, window.start(seed, plane), priors, max_steps=50, tolerance=tolerance)


# -- exact data -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("views", [2, 3, 8])
@pytest.mark.parametrize("camera", ["pinhole", "radtan", "radtan5", "fisheye"])
def test_exact_tracks_give_the_truth(camera, views, kind):
    for seed in range(3):
        window = make_window(SCENES[kind], seed, views, camera=CAMERAS[camera])
        fit = fitted(window, kind=kind, seed=seed)
        assert fit.cost < 1e-6
        assert window.rotation_error(fit.state) < 1e-6
        assert window.direction_error(fit.state) < 1e-5
        assert abs(fit.state.log_scale) < 1e-6


@pytest.mark.parametrize("views", [3, 8])
def test_the_fit_returns_relative_lengths_and_points(views):
    window = make_window("room", 4, views)
    state = fitted(window, seed=4).state
    lengths, true = np.linalg.norm(state.t, axis=1), np.linalg.norm(window.t, axis=1)
    np.testing.assert_allclose(lengths / lengths.max(), true / true.max(), atol=1e-6)
    used, truth = window.tracks.anchor >= 0, window.true_state()
    scale = lengths.max() / true.max()
    np.testing.assert_allclose(state.inverse_distances[used] * scale, truth.inverse_distances[used], rtol=1e-4)
    np.testing.assert_allclose(state.rays[used], truth.rays[used], atol=1e-6)


def test_the_length_of_the_longest_baseline_is_held():
    window = make_window("room", 4, 5, noise_px=0.7)
    start = window.start(4)
    fit = fitted(window, seed=4)
    assert fit.held_view == np.argmax(np.linalg.norm(start.t, axis=1))
    assert np.linalg.norm(fit.state.t[fit.held_view]) == pytest.approx(np.linalg.norm(start.t[fit.held_view]), rel=5e-3)


def test_a_start_at_the_true_poses_has_the_true_inverse_distances():
    window = make_window("room", 2, 4)
    used = window.tracks.anchor >= 0
    state = start_at(window.tracks, window.R, window.t)
    np.testing.assert_allclose(state.inverse_distances[used], window.true_state().inverse_distances[used], rtol=1e-6)
    assert not start_at(window.tracks, window.R, window.t, at_infinity=True).inverse_distances.any()


def test_a_step_never_raises_the_cost():
    window = make_window("room", 5, 4, noise_px=0.7)
    start = window.start(5, error=0.2)
    costs = [fit_window(window.tracks, start, PRIORS, max_steps=n, tolerance=0.0).cost for n in range(8)]
    assert (np.diff(costs) <= 0).all()


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("seed", range(4))
def test_outliers_move_the_fit_by_less_than_the_noise(seed, kind):
    window = make_window(SCENES[kind], seed, 4, 80)
    rng = np.random.default_rng(seed)
    tracks = window.tracks
    pixels, is_outlier = tracks.pixels.copy(), np.arange(tracks.pixels.shape[1]) % 8 == 0
    pixels[1:, is_outlier] = rng.uniform((0, 0), (640, 480), (3, is_outlier.sum(), 2))
    tracks = WindowTracks.gather(tracks.camera, tracks.frames, tracks.track_ids, pixels, tracks.seen, 0.7)
    fit, noisy = (
        fitted(w, kind=kind, seed=seed)
        for w in (replace(window, tracks=tracks), make_window(SCENES[kind], seed, 4, 80, noise_px=0.7))
    )
    assert window.direction_error(fit.state) < np.radians(direction_limit_deg(noisy))
    used = tracks.anchor >= 0
    assert np.median(fit.track_costs[used & is_outlier]) > 15
    assert np.median(fit.track_costs[used & ~is_outlier]) < 0.5


def direction_limit_deg(fit) -> float:
    """Two standard deviations of the direction of each view with noise: those of the least certain view."""
    as_pair = (replace(fit, state=replace(fit.state, R=fit.state.R[[0, k]], t=fit.state.t[[0, k]])) for k in (1, 2, 3))
    return 2 * max(direction_sigmas_deg(one)[1] for one in as_pair)


# -- invariances ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SCENES)
def test_permuting_the_tracks_changes_nothing(kind):
    window = make_window(SCENES[kind], 7, 4, noise_px=0.7)
    tracks = window.tracks
    order = np.random.default_rng(7).permutation(len(tracks.track_ids))
    permuted = replace(
        window,
        tracks=WindowTracks.gather(
            tracks.camera,
            tracks.frames,
            tracks.track_ids[order],
            tracks.pixels[:, order],
            tracks.seen[:, order],
            0.7,
        ),
    )
    a, b = (fitted(w, kind=kind, seed=7) for w in (window, permuted))
    np.testing.assert_allclose(a.state.R, b.state.R, atol=1e-7)
    np.testing.assert_allclose(a.state.t, b.state.t, atol=1e-7)
    np.testing.assert_allclose(a.track_costs[order], b.track_costs, atol=1e-4)


def test_the_order_of_further_views_does_not_matter():
    window = make_window("room", 8, 5, noise_px=0.7)
    order = [0, 1, 4, 2, 3]
    swapped = replace(window, tracks=window.tracks.of_views(tuple(order)), R=window.R[order], t=window.t[order])
    # The same start for both.
    start = window.start(8)
    a = fit_window(window.tracks, start, WIDE, max_steps=50, tolerance=1e-10)
    other = start_at(swapped.tracks, start.R[order], start.t[order])
    b = fit_window(swapped.tracks, other, WIDE, max_steps=50, tolerance=1e-10)
    assert a.cost == pytest.approx(b.cost, abs=1e-6)
    np.testing.assert_allclose(a.state.R[order], b.state.R, atol=1e-6)


def test_the_views_of_a_window_are_a_window():
    tracks = make_window("room", 9, 5, noise_px=0.7).tracks
    assert tracks.of_views((0, 1, 2, 3, 4)) is tracks
    part = tracks.of_views((0, 3))
    assert part.frames == (0, 3)
    np.testing.assert_array_equal(part.pixels, tracks.pixels[[0, 3]])
    np.testing.assert_array_equal(part.seen, tracks.seen[[0, 3]])
    both = tracks.seen[0] & tracks.seen[3]
    np.testing.assert_array_equal(part.anchor, np.where(both, 0, -1))
    np.testing.assert_allclose(part.places, tracks.places[[0, 3]])
    last_first = tracks.of_views((4, 0))
    used = last_first.anchor == 0
    np.testing.assert_allclose(last_first.rays[used], tracks.camera.bearings(tracks.pixels[4, used]))


def test_points_behind_the_cameras_cost_the_gate():
    window = make_window("wall", 3, 3)
    # A plane through which the left half of the rays never passes.
    plane = np.array([4.0, 0.0, 0.0])
    fit = fit_window(window.tracks, window.true_state(plane), PRIORS, max_steps=0)
    behind = (window.true_state().rays @ plane < -1e-3) & (window.tracks.anchor == 0)
    assert behind.sum() > 10
    np.testing.assert_allclose(fit.track_costs[behind], PRIORS.gate_sigmas**2 * window.tracks.seen.sum(axis=0)[behind])


# -- rotation only --------------------------------------------------------------------------------


def test_a_rotation_only_camera_is_fitted_with_all_points_at_infinity():
    window = make_window("rotation", 1, 4)
    t = np.outer(np.arange(4), [1e-9, 0, 0])
    fit = fit_window(window.tracks, start_at(window.tracks, window.R, t, at_infinity=True), PRIORS, rotation_only=True)
    assert fit.cost < 1e-6
    assert window.rotation_error(fit.state) < 1e-6
    assert not fit.state.inverse_distances.any()


def test_a_rotation_only_camera_tells_its_focal_length():
    true = camera_of(make_points("rotation", 2))
    window = make_window("rotation", 2, 6, 150, noise_px=0.3, stated=camera_with_focal_factor(true, 1.05))
    t = np.outer(np.arange(6), [1e-9, 0, 0])
    start = start_at(window.tracks, window.R, t, at_infinity=True)
    fit = fit_window(window.tracks, start, Priors(focal_sigma=0.1), rotation_only=True)
    assert np.exp(fit.state.log_scale) == pytest.approx(1 / 1.05, abs=0.01)


# -- noisy data -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("views", [3, 8])
def test_the_cost_of_noisy_tracks_is_their_degrees_of_freedom(views, kind):
    costs, freedoms = 0.0, 0.0
    for seed in range(5):
        window = make_window(SCENES[kind], seed, views, noise_px=0.7, baseline=0.3)
        fit = fitted(window, WIDE, kind, seed)
        used = window.tracks.anchor >= 0
        observations = int(window.tracks.seen[:, used].sum())
        own = 2 if kind == "plane" else 3  # unknowns of a track; those of the plane are three, and the scale is held
        costs += fit.cost
        freedoms += 2 * observations - own * int(used.sum()) - 6 * (views - 1) + (1 if kind == "general" else -2)
    assert abs(costs - freedoms) < 4 * np.sqrt(2 * freedoms)


def test_a_wrong_focal_length_is_found_where_the_camera_turns_and_translates():
    true = camera_of(make_points("room", 0))
    errors, sigmas = [], []
    for seed in range(8):
        window = make_window(
            "room", seed, 6, 120, noise_px=0.3, baseline=0.5, turning=0.15, stated=camera_with_focal_factor(true, 1.02)
        )
        fit = fitted(window, Priors(focal_sigma=0.03), seed=seed)
        errors.append(fit.state.log_scale + np.log(1.02))
        sigmas.append(focal_sigma(fit))
    z = np.array(errors) / sigmas
    assert max(sigmas) < 0.005  # the prior alone has 0.03
    assert np.abs(z).max() < 4
    assert np.sqrt(np.mean(z**2)) < 2


def test_error_fields_enlarge_the_uncertainty_and_leave_the_state():
    window = make_window("room", 1, 6, 150, noise_px=0.7, baseline=0.1)
    priors = Priors(focal_sigma=0.03, field_sigma_px=0.1)
    without = fitted(window, seed=1)
    fit = with_error_fields(window.tracks, without, priors)
    assert fit.state is without.state
    assert (fit.cost, fit.field_size, without.field_size) == (without.cost, 12, 0)
    rotation, direction = np.divide(direction_sigmas_deg(fit), direction_sigmas_deg(without))
    assert rotation > 1
    assert 1.05 < direction < 5


def test_fields_of_no_size_leave_the_uncertainty():
    window = make_window("room", 1, 4, noise_px=0.7)
    without = fitted(window, seed=1)
    fit = with_error_fields(window.tracks, without, replace(PRIORS, field_sigma_px=1e-7))
    np.testing.assert_allclose(direction_sigmas_deg(fit), direction_sigmas_deg(without), rtol=1e-4)


def test_a_smooth_error_of_a_view_is_found_as_its_field():
    window = make_window("room", 2, 6, 150, sigma_px=0.2, baseline=0.4)
    tracks, place = window.tracks, 0.4
    pixels = tracks.pixels.copy()
    pixels[2, :, 0] += 0.5 * tracks.places[2, :, 3] * 0.2  # half a pixel times u^2, in x
    bent = WindowTracks.gather(tracks.camera, tracks.frames, tracks.track_ids, pixels, tracks.seen, 0.2)
    start = window.start(2, error=place * 0.01)
    stiff, soft = (fit_window(bent, start, Priors(0.02, sigma), max_steps=50, tolerance=1e-9) for sigma in (0.0, 1.0))
    # The residual is the projection less the pixel, so the field is the error itself.
    assert soft.state.field[2, 3] == pytest.approx(0.5, abs=0.15)
    assert soft.cost < 0.2 * stiff.cost
    assert window.direction_error(soft.state) < window.direction_error(stiff.state)


# -- coverage -------------------------------------------------------------------------------------


def test_the_error_of_the_direction_has_the_stated_size():
    """40 rooms, baseline 0.1 of the median depth: the error in units of its covariance is about 1 per component."""
    squares, directions = [], []
    for seed in range(40):
        window = make_window("room", 1000 + seed, 8, 100, noise_px=0.7, baseline=0.1)
        window = replace(window, tracks=window.tracks.of_views((0, 7, 1, 2, 3, 4, 5, 6)))
        window = replace(window, R=window.R[[0, 7, 1, 2, 3, 4, 5, 6]], t=window.t[[0, 7, 1, 2, 3, 4, 5, 6]])
        fit = fitted(window, seed=seed, tolerance=1e-4)
        R, t = fit.state.R[1], fit.state.t[1]
        found, true = R.T @ t / np.linalg.norm(t), window.R[1].T @ window.t[1] / np.linalg.norm(window.t[1])
        # Covariance of the direction R^T t / |t| in a basis orthogonal to it.
        basis = np.linalg.svd(found[None])[2][1:]
        cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
        J = basis @ np.hstack([R.T @ cross, R.T]) / np.linalg.norm(t)
        covariance = J @ fit.pose_covariance(1) @ J.T
        error = basis @ true
        squares.append(error @ np.linalg.solve(covariance, error) / 2)
        largest = np.degrees(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        assert direction_sigmas_deg(fit)[1] == pytest.approx(largest, rel=1e-6)
        directions.append(np.degrees(np.linalg.norm(error)) / largest)
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.4
    # Of the larger axis alone: between 1 and the square root of 2.
    assert 0.6 < np.sqrt(np.mean(np.square(directions))) < 2
