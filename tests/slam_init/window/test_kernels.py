"""Laws of the compiled loop of the joint fit: its costs and its equations are those of the robust cost."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS
from make_window import cost_at, equations, make_window, moved
from window_reference import reference_equations

from slam_init.types.lens import Lens
from slam_init.window.arguments import Known, Layout, Unknowns
from slam_init.window.projection import camera_vector, project_point
from slam_init.window.steps import move_tracks
from slam_init.window.track_equations import eliminate
from slam_init.window.tracks import Readout

#: Far from all residuals of noise, near enough that the robust weights differ from 1.
GATE = 5.0


def world(kind, seed=1, views=3, camera=None, drift_px=0.0):
    """Noisy tracks and a state off the truth by a few standard deviations of the noise."""
    scene = "wall" if kind == "plane" else "room"
    window = make_window(scene, seed, views, 25, noise_px=1.0, baseline=0.3, turning=0.1, camera=camera)
    # A track may start in a later view: hide some from the first one.
    seen = window.tracks.seen.copy()
    seen[0, ::4] = False
    tracks = window.tracks
    sweep_px_s = 300.0 * np.random.default_rng((seed, 5)).normal(size=(*seen.shape, 2))
    readout = Readout(sweep_px_s, np.zeros(len(seen)), 0.002, np.zeros(len(seen)))
    # Tracks that slide along a direction of their own.
    slides = drift_px * np.random.default_rng((seed, 6)).normal(size=(*seen.shape, 2))
    drifts = np.einsum("...i,...j->...ij", slides, slides) if drift_px else None
    tracks = type(tracks).gather(
        tracks.camera, tracks.frames, tracks.track_ids, tracks.pixels, seen, 1.0, readout,
        least_noise_px=0.5, drifts=drifts,
    )  # fmt: skip
    window = replace(window, tracks=tracks)
    state = window.true_state(window.plane if kind == "plane" else None)
    rng = np.random.default_rng((seed, 3))
    t = state.t.copy()
    t[1:] += 1e-3 * rng.normal(size=t[1:].shape)
    # Of the tracks of a plane, a fifth leaves it.
    on_plane = state.on_plane & (np.arange(len(state.on_plane)) % 5 > 0)
    field = 0.2 * rng.normal(size=state.field.shape)
    return tracks, replace(state, t=t, lens=Lens(2e-3, 0.02, 0.003), field=field, on_plane=on_plane)


def test_points_behind_a_plane_cost_the_gate_in_each_view():
    tracks, state = world("plane")
    state = replace(state, on_plane=np.ones_like(state.on_plane))
    used = tracks.anchor >= 0
    found = equations(tracks, replace(state, plane=-state.plane), GATE)
    np.testing.assert_allclose(found.costs[used], GATE**2 * tracks.seen.sum(axis=0)[used])
    assert np.isinf(found.squares[:, used][tracks.seen[:, used]]).all()
    assert not found.gradient.any()


def test_an_observation_beyond_the_root_of_three_gates_costs_the_gate_and_has_no_influence():
    tracks, state = world("free")
    i = int(np.flatnonzero(tracks.seen.all(axis=0))[0])
    rest, far = tracks.seen.copy(), tracks.pixels.copy()
    rest[2, i] = False
    far[2, i] += 2 * GATE * tracks.sigma_px[2, i]
    without = equations(replace(tracks, seen=rest), state, GATE)
    outlier = equations(replace(tracks, pixels=far), state, GATE)
    assert 3 * GATE**2 < outlier.squares[2, i] < np.inf
    assert outlier.costs[i] == pytest.approx(without.costs[i] + GATE**2)
    np.testing.assert_array_equal(outlier.normal, without.normal)
    np.testing.assert_array_equal(outlier.gradient, without.gradient)


def test_a_step_of_the_eliminated_equations_is_that_of_all_unknowns():
    rng = np.random.default_rng(4)
    count, size = 5, 7
    J = rng.normal(size=(60, size + 3 * count))
    # No observation depends on two tracks.
    for row, track in enumerate(rng.integers(0, count, len(J))):
        J[row, size:][np.arange(3 * count) // 3 != track] = 0.0
    full, e = J.T @ J, rng.normal(size=len(J))
    right = J.T @ e
    own = [slice(size + 3 * i, size + 3 * i + 3) for i in range(count)]
    halves = [np.linalg.solve(np.linalg.cholesky(full[i, i]), np.column_stack([full[i, :size], right[i]])) for i in own]
    normal, gradient = np.tril(full[:size, :size]), right[:size].copy()
    eliminate(normal, gradient, np.array(halves))
    np.testing.assert_allclose(np.linalg.solve(normal, gradient), np.linalg.solve(full, right)[:size], rtol=1e-8)


def test_a_track_that_is_left_out_has_no_cost_and_no_equations():
    tracks, state = world("free")
    without = replace(tracks, anchor=np.where(np.arange(len(tracks.anchor)) == 3, -1, tracks.anchor))
    all_, fewer = equations(tracks, state, GATE), equations(without, state, GATE)
    assert fewer.costs[3] == 0
    assert fewer.cost == pytest.approx(all_.cost - all_.costs[3])
    assert not fewer.back[3].any()


@pytest.mark.parametrize("unknowns", ["", "field readout", "principal"])
@pytest.mark.parametrize("kind", ["free", "plane"])
def test_the_equations_are_those_of_the_readable_reference(kind, unknowns):
    tracks, state = world(kind, views=4, camera=CAMERAS["radtan"], drift_px=2.0)
    options = {f"with_{name}": name in unknowns for name in ("field", "readout", "principal")}
    found, expected = equations(tracks, state, GATE, **options), reference_equations(tracks, state, GATE, **options)
    assert found.cost == pytest.approx(expected.cost)
    scale = np.sqrt(np.diag(expected.normal)) + 1.0
    np.testing.assert_allclose(
        found.normal / np.outer(scale, scale), expected.normal / np.outer(scale, scale), atol=1e-9
    )
    np.testing.assert_allclose(found.gradient / scale, expected.gradient / scale, atol=1e-8)
    np.testing.assert_allclose(found.shares / scale, expected.shares / scale, atol=1e-8)


@pytest.mark.parametrize(("unknowns", "camera"), [("", "pinhole"), ("field readout principal", "fisheye")])
@pytest.mark.parametrize("kind", ["free", "plane"])
def test_the_gradient_is_the_slope_of_the_cost_along_a_step_that_the_tracks_follow(kind, unknowns, camera):
    tracks, state = world(kind, camera=CAMERAS[camera], drift_px=2.0)
    options = {f"with_{name}": name in unknowns for name in ("field", "readout", "principal")}
    found = equations(tracks, state, GATE, **options)
    scale = np.sqrt(np.diag(found.normal))
    size, step = len(found.gradient), 1e-4
    for unknown in range(size):
        along = np.zeros(size)
        along[unknown] = step / max(scale[unknown], 1.0)
        ahead, behind = (
            cost_at(tracks, moved(state, s * along, found.back, **options), GATE, **options) for s in (1, -1)
        )
        slope = (ahead - behind) / (2 * along[unknown])
        # The equations are those of half of the cost.
        assert 2 * found.gradient[unknown] == pytest.approx(slope, rel=1e-4, abs=1e-4 * scale[unknown])


def test_the_gradient_is_right_for_tracks_whose_distance_is_held():
    tracks, state = world("free")
    free = np.zeros(len(tracks.anchor), bool)
    found = equations(tracks, state, GATE, free=free)
    assert not found.back[:, 2].any()
    size = len(found.gradient)
    for unknown in range(size):
        along = np.zeros(size)
        along[unknown] = 1e-6
        ahead, behind = (cost_at(tracks, moved(state, s * along, found.back, with_field=False), GATE) for s in (1, -1))
        assert 2 * found.gradient[unknown] == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=0.05)


#: Focal length and k1 among the unknowns of :func:`tracks_after`.
LENS = slice(12, 14)


def tracks_after(rays, rho, free, on_plane, back, step, length=1.0, *, camera="radtan", lens=(0.0, 0.0)):
    """The rays and the inverse distances of tracks after a step of three views, a lens and a plane."""
    layout = Layout.of(3, field=False, readout=False, principal=False)
    assert (layout.focal, layout.plane + 3) == (LENS.start, len(step))
    before = Unknowns.empty(3, on_plane)
    before.scene.rays[:], before.scene.inverse_distances[:], before.lens[:2] = rays, rho, lens
    none = np.zeros(3)
    turned = (np.zeros((3, 3, 3)), none, np.zeros((3, 3)), none)
    known = Known(camera_vector(CAMERAS[camera]), 0.0, False, np.zeros(len(step)), np.zeros(5), *turned)
    after = Unknowns.empty(3, on_plane).scene
    move_tracks(before, step, length, known, layout, back, free, after)
    return after.rays, after.inverse_distances


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
@pytest.mark.parametrize("by_lens", [(0.1, 0.0), (0.0, 0.1), (-0.1, 0.05)])
def test_the_pixel_of_a_ray_follows_a_large_step_of_the_lens_to_first_order(model, by_lens):
    camera, lens, by_lens = camera_vector(CAMERAS[model]), np.array([0.02, -0.01]), np.array(by_lens)
    rays = np.array([[0.0, 0.0, 1.0], [0.1, -0.05, 1.0], [0.4, 0.3, 1.0], [-0.3, 0.2, 1.0]])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    step = np.zeros(17)
    step[LENS] = by_lens
    no = np.zeros(4, bool)
    moved, _ = tracks_after(rays, np.zeros(4), no, no, np.zeros((4, 3, 21)), step, camera=model, lens=lens)
    for before, after in zip(rays, moved, strict=True):
        _, x, y, *_, x_k1, y_k1 = project_point(camera, np.exp(lens[0]), lens[1], *before)
        expected = (
            np.array([x, y]) + (np.array([x, y]) - camera[3:5]) * by_lens[0] + np.array([x_k1, y_k1]) * by_lens[1]
        )
        _, u, v, *_ = project_point(camera, np.exp(lens[0] + by_lens[0]), lens[1] + by_lens[1], *after)
        # A ray that stays would be off by 2 to 30 pixels away from the centre.
        np.testing.assert_allclose([u, v], expected, atol=0.05)


def test_a_ray_that_the_lens_does_not_see_takes_its_step():
    behind, no, step = np.array([[0.0, 0.6, -0.8]]), np.zeros(1, bool), np.zeros(17)
    step[LENS] = 0.1
    moved, _ = tracks_after(behind, np.zeros(1), no, no, np.zeros((1, 3, 21)), step)
    np.testing.assert_allclose(moved, behind)
