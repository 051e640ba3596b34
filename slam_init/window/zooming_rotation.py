"""The camera that only rotates, with a lens that zooms from view to view: a rival of a motion toward a plane.

A lens that focuses changes the focal length of each view by up to some hundredths. That looks like a motion toward a
plane. So a map has to gain over this camera too. A zoom ``z`` of a view is undone in its pixels, ``c + (x - c) / (1 +
z)``, and the noise is that of the pixels as measured. The rotations and the zooms of the views are nearly independent,
so that they are fitted in turn.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.joint_fit import fit_window, start_noise_factor
from slam_init.window.levels import LARGEST_ZOOM, ZOOMED_COST
from slam_init.window.state import WindowState, start_at
from slam_init.window.tracks import WindowTracks

#: Rotations and zooms are fitted in turn so often. It ends where a round lowers the cost by less than this share of
#: what is left to the best motion: zooms do not explain it then.
_ROUNDS, _MAX_STEPS, _LEAST_PROGRESS = 8, 30, 0.1
#: A start whose residuals are this many times the noise is far from the answer.
_FAR_FACTOR = 1.5
#: Pixels nearer to the centre than this share of the width tell little of a zoom.
_CENTRAL = 0.1


def with_zooms(hypotheses: WindowHypotheses) -> WindowHypotheses:
    """The same hypotheses, but the rotation-only camera zooms from view to view, its zooms undone in the tracks."""
    tracks, best, rotating = hypotheses.tracks, hypotheses.motions[0].fit, hypotheses.rotation_only.state
    R = best.state.R if len(best.state.R) == len(rotating.R) else rotating.R
    # A readout would take the place of zooms.
    priors = replace(hypotheses.priors, readout_sigma_s=0.0)
    t = np.outer(np.arange(len(R)), [1e-9, 0.0, 0.0])
    state = start_at(tracks, R, t, readout_s=tracks.readout_s, at_infinity=True)
    zooms, lowest, before = np.zeros(len(R)), hypotheses, math.inf
    for _ in range(_ROUNDS):
        part = _zoomed(tracks, zooms)
        zooms = (1 + zooms) * (1 + _further_zooms(part, state)) - 1
        part = _zoomed(tracks, zooms)
        start = _again(part, state)
        factor = start_noise_factor(part, start, priors, rotation_only=True)
        for wider in (factor, math.sqrt(factor)) if factor > _FAR_FACTOR else ():
            wide = part.with_noise(wider * part.noise_px)
            start = fit_window(wide, start, priors, rotation_only=True, max_steps=_MAX_STEPS).state
        start = _again(part, start)
        fit = fit_window(part, start, priors, rotation_only=True, max_steps=_MAX_STEPS)
        state, cost = fit.state, fit.cost + min(float(np.sum((zooms / LARGEST_ZOOM) ** 2)), ZOOMED_COST)
        if cost < lowest.rotation_only.cost:
            lowest = replace(hypotheses, tracks=part, rotation_only=replace(fit, cost=cost), rotation_priors=priors)
        if before - cost < _LEAST_PROGRESS * (cost - best.cost):
            break
        before = cost
    return lowest


def _again(tracks: WindowTracks, state: WindowState) -> WindowState:
    """The rotations and the lens of a state, with the rays as measured."""
    return start_at(
        tracks, state.R, state.t, log_scale=state.log_scale, k1=state.k1, readout_s=state.readout_s,
        principal_px=state.principal_px, at_infinity=True,
    )  # fmt: skip


def _zoomed(tracks: WindowTracks, zooms: Floats) -> WindowTracks:
    """The tracks with the zooms (V,) of the views undone."""
    centre, factors = np.array([tracks.camera.cx, tracks.camera.cy]), 1 + zooms
    pixels = centre + (tracks.pixels - centre) / factors[:, None, None]
    places = tracks.places * factors[:, None, None]
    return replace(tracks, pixels=pixels, sigma_px=tracks.sigma_px / factors[:, None], places=places)


def _further_zooms(tracks: WindowTracks, state: WindowState) -> Floats:
    """The zooms (V,) of the views but the first that are left, by the medians over the tracks."""
    camera = tracks.camera.refocused(state.log_scale, state.k1)
    centre = np.array([camera.cx, camera.cy])
    anchor, further = np.maximum(tracks.anchor, 0), np.zeros(len(state.R))
    for k in range(1, len(state.R)):
        turned = np.einsum("tij,tj->ti", state.R[k] @ np.swapaxes(state.R[anchor], 1, 2), state.rays)
        expected = camera.project(turned) - centre
        lengths = np.linalg.norm(expected, axis=1)
        used = tracks.seen[k] & (tracks.anchor >= 0) & (anchor != k) & np.isfinite(expected).all(axis=1)
        used &= lengths > _CENTRAL * camera.width
        if used.any():
            measured = (tracks.pixels[k] - state.principal_px - centre)[used]
            further[k] = float(np.median(np.einsum("ti,ti->t", measured, expected[used]) / lengths[used] ** 2)) - 1
    return further
