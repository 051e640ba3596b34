"""Laws of the joint fit: exact data give the truth, noisy data a cost and an uncertainty that can be believed."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS
from make_window import (
    PRIORS,
    camera_of,
    direction_sigma_deg,
    fit_near_truth,
    focal_sigma,
    make_window,
    pair_and_further,
    point_source,
)

from sequences_synth.points import make_points
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.window.arguments import Limits
from slam_init.window.equations import WindowEquations
from slam_init.window.joint_fit import costs_off_plane, fit_window, start_noise_factor
from slam_init.window.kernel import OFF_PLANE_COST
from slam_init.window.state import Priors, start_at
from slam_init.window.tracks import WindowTracks, gather_tracks

SCENES = {"general": "room", "plane": "wall"}
#: No observation is an outlier.
WIDE = replace(PRIORS, gate_sigmas=1e3)


# -- exact data -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize(("camera", "views"), [("pinhole", 8), ("radtan", 2), ("radtan5", 3), ("fisheye", 3)])
def test_exact_tracks_give_the_truth(camera, views, kind):
    for seed in range(3):
        window = make_window(SCENES[kind], seed, views, camera=CAMERAS[camera])
        fit = fit_near_truth(window, kind=kind, seed=seed)
        assert fit.cost < 1e-6
        assert window.rotation_error(fit.state) < 1e-6
        assert window.direction_error(fit.state) < 1e-5
        assert abs(fit.state.lens.log_scale) < 1e-6


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("max_steps", [0, 2, 12])
def test_a_fit_has_the_costs_and_the_equations_of_the_state_where_it_ends(kind, max_steps):
    window = make_window(SCENES[kind], 5, 5, noise_px=0.7)
    start = window.start(5, 1.03 * window.plane if kind == "plane" else None)
    fit = fit_window(window.tracks, start, PRIORS, limits=Limits(max_steps))
    assert fit.iterations <= max_steps
    equations = WindowEquations(window.tracks, fit.state, PRIORS)
    equations.held_view = fit.held_view
    assert equations.build(fit.state) == pytest.approx(fit.cost, rel=1e-12)
    np.testing.assert_array_equal(fit.track_costs, equations.costs)
    np.testing.assert_array_equal(fit.residuals, equations.residuals)
    np.testing.assert_array_equal(fit.information, equations.information(fit.state))
    # Asked again, or after another fit of the same tracks, they are the same.
    fit_window(window.tracks, start, PRIORS)
    np.testing.assert_array_equal(fit.information, equations.information(fit.state))


@pytest.mark.parametrize(("seed", "kind"), [(0, "general"), (1, "general"), (2, "plane"), (3, "plane")])
def test_outliers_move_the_fit_by_less_than_the_noise(seed, kind):
    window = make_window(SCENES[kind], seed, 4, 80)
    rng = np.random.default_rng(seed)
    tracks = window.tracks
    pixels, is_outlier = tracks.pixels.copy(), np.arange(tracks.pixels.shape[1]) % 8 == 0
    pixels[1:, is_outlier] = rng.uniform((0, 0), (640, 480), (3, is_outlier.sum(), 2))
    tracks = WindowTracks.gather(tracks.camera, tracks.frames, tracks.track_ids, pixels, tracks.seen, 0.7)
    fit, noisy = (
        fit_near_truth(w, kind=kind, seed=seed)
        for w in (replace(window, tracks=tracks), make_window(SCENES[kind], seed, 4, 80, noise_px=0.7))
    )
    assert window.direction_error(fit.state) < np.radians(direction_limit_deg(noisy))
    used = tracks.anchor >= 0
    assert np.median(fit.track_costs[used & is_outlier]) > 15
    assert np.median(fit.track_costs[used & ~is_outlier]) < 0.5


def direction_limit_deg(fit) -> float:
    """Two standard deviations of the direction of each view with noise: those of the least certain view."""
    return 2 * max(direction_sigma_deg(fit, view) for view in (1, 2, 3))


# -- tracks off the plane -------------------------------------------------------------------------


def test_points_behind_the_cameras_leave_the_plane():
    window = make_window("wall", 3, 3)
    # A plane through which the left half of the rays never passes.
    plane = np.array([4.0, 0.0, 0.0])
    fit = fit_window(window.tracks, window.true_state(plane), PRIORS, limits=Limits(max_steps=0))
    behind = (window.true_state().rays @ plane < -1e-3) & (window.tracks.anchor == 0)
    assert behind.sum() > 10
    assert not fit.state.on_plane[behind].any()
    np.testing.assert_allclose(fit.track_costs[behind], OFF_PLANE_COST, atol=1e-6)


def wall_with_panels(seed, relief):
    """Noisy tracks of a wall; the points of every fifth track stand before it by a share of their depth."""
    flat = make_window("wall", seed, 5, 80, baseline=0.3)
    stands = np.arange(80 * 115 // 100) % 5 == 0
    points = np.where(stands[:, None], (1 - relief) * flat.points, flat.points)
    camera, rng = flat.tracks.camera, np.random.default_rng((seed, 5))
    pixels = np.array([camera.project(points @ R.T + t) for R, t in zip(flat.R, flat.t, strict=True)])
    seen = ((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))).all(axis=-1)
    pixels = pixels + 0.7 * rng.normal(size=pixels.shape)
    tracks = WindowTracks.gather(camera, flat.tracks.frames, flat.tracks.track_ids, pixels, seen, 0.7)
    plane = flat.plane
    return replace(flat, tracks=tracks, points=points), plane, stands


@pytest.mark.parametrize("seed", range(3))
def test_depth_variation_leaves_the_plane_and_the_rest_stays(seed):
    window, plane, stands = wall_with_panels(seed, 0.4)
    fit = fit_window(window.tracks, window.start(seed, 1.01 * plane, 0.002), PRIORS)
    used = window.tracks.seen.sum(axis=0) >= 4
    off = ~fit.state.on_plane
    assert off[used & stands].mean() > 0.9
    assert off[used & ~stands].mean() < 0.05
    assert (fit.track_costs[off & used] >= OFF_PLANE_COST).all()
    assert window.direction_error(fit.state) < np.radians(3)
    # A plane without depth variation costs its tracks more.
    costs = costs_off_plane(fit)
    np.testing.assert_allclose(costs[off], fit.track_costs[off] - OFF_PLANE_COST, atol=0.5)


# -- rotation only --------------------------------------------------------------------------------


def test_a_rotation_only_camera_determines_its_focal_length():
    true = camera_of(make_points("rotation", 2))
    window = make_window("rotation", 2, 6, 150, noise_px=0.3, stated=camera_with_focal_factor(true, 1.05))
    t = np.outer(np.arange(6), [1e-9, 0, 0])
    start = start_at(window.tracks, window.R, t, at_infinity=True)
    fit = fit_window(window.tracks, start, Priors(focal_sigma=0.1), rotation_only=True)
    assert np.exp(fit.state.lens.log_scale) == pytest.approx(1 / 1.05, abs=0.01)


# -- noisy data -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("views", [3, 8])
def test_the_cost_of_noisy_tracks_is_their_degrees_of_freedom(views, kind):
    costs, freedoms = 0.0, 0.0
    for seed in range(5):
        window = make_window(SCENES[kind], seed, views, noise_px=0.7, baseline=0.3)
        fit = fit_near_truth(window, WIDE, kind, seed)
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
        fit = fit_near_truth(window, Priors(focal_sigma=0.03), seed=seed)
        errors.append(fit.state.lens.log_scale + np.log(1.02))
        sigmas.append(focal_sigma(fit))
    z = np.array(errors) / sigmas
    assert max(sigmas) < 0.005  # the prior alone has 0.03
    assert np.abs(z).max() < 4
    assert np.sqrt(np.mean(z**2)) < 2


def test_a_smooth_error_of_a_view_is_found_as_its_field():
    window = make_window("room", 2, 6, 150, sigma_px=0.2, baseline=0.4)
    tracks, place = window.tracks, 0.4
    pixels = tracks.pixels.copy()
    pixels[2, :, 0] += 0.5 * tracks.places[2, :, 3] * 0.2  # half a pixel times the fourth polynomial, in x
    bent = WindowTracks.gather(tracks.camera, tracks.frames, tracks.track_ids, pixels, tracks.seen, 0.2)
    start = window.start(2, error=place * 0.01)
    stiff, soft = (
        fit_window(bent, start, Priors(0.02, field_sigma_px=sigma), limits=Limits(50, 1e-9)) for sigma in (0.0, 1.0)
    )
    # The residual is the projection less the pixel, so the field is the error itself.
    assert soft.state.field[2, 3] == pytest.approx(0.5, abs=0.15)
    assert soft.cost < 0.2 * stiff.cost
    assert window.direction_error(soft.state) < window.direction_error(stiff.state)


# -- a lens that moves far ------------------------------------------------------------------------


@pytest.mark.parametrize("k1", [-0.2, 0.15])
def test_no_track_stays_behind_where_the_distortion_moves_by_many_pixels(k1):
    source = point_source("rotation", 1, views=6, points=300, outliers=0, noise_px=0.1, k1=k1)
    observations = pair_and_further(list(source.observations()), 6)
    tracks = gather_tracks(source.camera, observations, 0.1)
    true = [pose.R.T for pose in source.groundtruth.world_from_cam]
    R = np.array([true[one.frame] @ true[observations[0].frame].T for one in observations])
    t = np.outer(np.arange(len(R)), [1e-9, 0, 0])
    start = start_at(tracks, R, t, at_infinity=True)
    priors = replace(PRIORS, k1_sigma=0.15)
    # The start has rays of a camera without distortion: at the corners of the image they are off by many pixels.
    coarse = tracks.with_noise(start_noise_factor(tracks, start, priors, rotation_only=True) * 0.1)
    start = fit_window(coarse, start, priors, rotation_only=True).state
    fit = fit_window(tracks, start, priors, rotation_only=True)
    assert fit.state.lens.k1 == pytest.approx(k1, abs=0.01)
    assert fit.explained > 0.99 * (tracks.anchor >= 0).sum()
