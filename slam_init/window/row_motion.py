"""What the translation of the camera moves in an image while a rolling shutter reads it.

The turning of the camera is known for each frame (:mod:`slam_init.frontend.rolling_shutter`). It was found as the
rotation between neighbouring frames that aligns all tracks best, so it contains what a rotation can explain of the
parallax. What the parallax of a single track differs from that depends on its distance and on the velocity of the
camera. Both are known once a window has been fitted. With the velocity ``v`` of the points in the camera frame and the
inverse distance ``rho`` along the unit ray ``d``, the ray moves by ``rho v`` and the best rotation by ``m`` ::

    m = (sum (I - d d^T))^-1  sum rho d x v
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.frontend.rolling_shutter import image_flow, readout_places
from slam_init.types.arrays import Floats
from slam_init.window.state import WindowState
from slam_init.window.tracks import WindowTracks


def with_translation(tracks: WindowTracks, state: WindowState) -> WindowTracks:
    """Add what the translation of the camera moves to the sweeps of the tracks, and correct their pixels for it.

    * ``tracks``: In the views of the state. Their sweeps are those of the turning.
    * ``state``: The velocity is that of its poses, the distances are its own.
    * Returns: The same tracks where the time stamps do not increase or no turning is known.
    """
    order = np.argsort(tracks.times_s, kind="stable")
    times = tracks.times_s[order]
    if not tracks.sweep_px_s.any() or (np.diff(times) <= 0).any():
        return tracks
    centres = -np.einsum("kji,kj->ki", state.R, state.t)
    velocity = np.empty_like(centres)
    velocity[order] = np.gradient(centres[order], times, axis=0)
    added = np.zeros_like(tracks.sweep_px_s)
    for k in range(len(centres)):
        known = tracks.sweep_px_s[k].any(axis=1) & tracks.seen[k] & (tracks.anchor >= 0)
        rays, inverse = _rays_in_view(tracks, state, k)
        known &= np.isfinite(rays).all(axis=1)
        if known.sum() < 3:
            continue
        d, rho = rays[known], inverse[known, None]
        moved = -rho * (state.R[k] @ velocity[k])
        aligned = np.linalg.solve(len(d) * np.eye(3) - d.T @ d, np.cross(d, moved).sum(axis=0))
        flow = image_flow(tracks.camera, d, moved - np.cross(aligned, d))
        places = readout_places(tracks.camera, tracks.pixels[k, known])
        added[k, known] = np.nan_to_num(flow) * places[:, None]
    # The pixels were corrected for the turning alone.
    return replace(tracks, pixels=tracks.pixels - tracks.readout_s * added, sweep_px_s=tracks.sweep_px_s + added)


def _rays_in_view(tracks: WindowTracks, state: WindowState, k: int) -> tuple[Floats, Floats]:
    """Unit rays (T, 3) of the points in a view, and their inverse distances (T,)."""
    anchor = np.maximum(tracks.anchor, 0)
    rho = state.inverse_distances.copy()
    if state.plane is not None:
        world = np.einsum("tji,tj->ti", state.R[anchor], state.rays)
        centre = -np.einsum("tji,tj->ti", state.R[anchor], state.t[anchor])
        on_plane = (world @ state.plane) / (1 - centre @ state.plane)
        rho = np.where(state.on_plane, np.maximum(on_plane, 0.0), rho)
    in_world = np.einsum("tji,tj->ti", state.R[anchor], state.rays - rho[:, None] * state.t[anchor])
    points = in_world @ state.R[k].T + rho[:, None] * state.t[k]
    lengths = np.maximum(np.linalg.norm(points, axis=1), 1e-300)
    return points / lengths[:, None], rho / lengths
