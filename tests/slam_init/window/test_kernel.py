"""Laws of the compiled loop of the joint fit: its costs and its equations are those of the robust cost."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import CAMERAS
from make_window import equations, make_window, moved
from window_reference import reference_equations

from slam_init.types.lens import Lens
from slam_init.window.arguments import FIELD_TERMS, ZOOM_TERMS

#: Far from all residuals of noise, near enough that the robust weights differ from 1.
GATE = 5.0


def world(kind, seed=1, views=3, camera=None, drift_px=0.0, *, field=0):
    """Noisy tracks and a state off the truth by a few standard deviations of the noise."""
    scene = "wall" if kind == "plane" else "room"
    # More tracks than a block has.
    window = make_window(scene, seed, views, 50, noise_px=1.0, baseline=0.3, turning=0.1, camera=camera)
    # A track may start in a later view: hide some from the first one.
    seen = window.tracks.seen.copy()
    seen[0, ::4] = False
    tracks = window.tracks
    sweep_px_s = 300.0 * np.random.default_rng((seed, 5)).normal(size=(*seen.shape, 2))
    # Tracks that slide along a direction of their own.
    slides = drift_px * np.random.default_rng((seed, 6)).normal(size=(*seen.shape, 2))
    drifts = np.einsum("...i,...j->...ij", slides, slides) if drift_px else None
    tracks = type(tracks).gather(
        tracks.camera, tracks.frames, tracks.track_ids, tracks.pixels, seen, 1.0, least_noise_px=0.5, drifts=drifts
    )
    tracks = replace(tracks, sweep_px_s=sweep_px_s, readout_s=0.002)
    window = replace(window, tracks=tracks)
    state = window.true_state(window.plane if kind == "plane" else None)
    rng = np.random.default_rng((seed, 3))
    t = state.t.copy()
    t[1:] += 1e-3 * rng.normal(size=t[1:].shape)
    # Of the tracks of a plane, a fifth leaves it.
    on_plane = state.on_plane & (np.arange(len(state.on_plane)) % 5 > 0)
    fields = 0.2 * rng.normal(size=state.field.shape)
    fields[:, 0] *= 0.02 if field == ZOOM_TERMS else 1.0
    return tracks, replace(state, t=t, lens=Lens(2e-3, 0.02, 0.003), field=fields, on_plane=on_plane)


def options_of(unknowns):
    """The common unknowns beside poses, focal length and k1, by their names."""
    field = FIELD_TERMS * ("field" in unknowns) + ZOOM_TERMS * ("zoom" in unknowns)
    return {"field": field, "readout": "readout" in unknowns, "principal": "principal" in unknowns}


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


@pytest.mark.parametrize("unknowns", ["", "field readout", "principal", "zoom"])
@pytest.mark.parametrize("kind", ["free", "plane"])
def test_the_equations_are_those_of_the_readable_reference(kind, unknowns):
    options = options_of(unknowns)
    tracks, state = world(kind, views=4, camera=CAMERAS["radtan"], drift_px=2.0, field=options["field"])
    found, expected = equations(tracks, state, GATE, **options), reference_equations(tracks, state, GATE, **options)
    assert found.costs.sum() == pytest.approx(expected.cost)
    scale = np.sqrt(np.diag(expected.normal)) + 1.0
    np.testing.assert_allclose(
        found.normal / np.outer(scale, scale), expected.normal / np.outer(scale, scale), atol=1e-9
    )
    np.testing.assert_allclose(found.gradient / scale, expected.gradient / scale, atol=1e-8)
    np.testing.assert_allclose(found.shares / scale, expected.shares / scale, atol=1e-8)


@pytest.mark.parametrize(
    ("unknowns", "camera"), [("", "pinhole"), ("field readout principal", "fisheye"), ("zoom", "radtan")]
)
@pytest.mark.parametrize("kind", ["free", "plane"])
def test_the_gradient_is_the_slope_of_the_cost_along_a_step_that_the_tracks_follow(kind, unknowns, camera):
    options = options_of(unknowns)
    tracks, state = world(kind, camera=CAMERAS[camera], drift_px=2.0, field=options["field"])
    found = equations(tracks, state, GATE, **options)
    scale = np.sqrt(np.diag(found.normal))
    size, step = len(found.gradient), 1e-4
    for unknown in range(size):
        along = np.zeros(size)
        along[unknown] = step / max(scale[unknown], 1.0)
        ahead, behind = (
            equations(tracks, moved(state, s * along, found, **options), GATE, **options).costs.sum() for s in (1, -1)
        )
        slope = (ahead - behind) / (2 * along[unknown])
        # The equations are those of half of the cost.
        assert 2 * found.gradient[unknown] == pytest.approx(slope, rel=1e-4, abs=1e-4 * scale[unknown])
