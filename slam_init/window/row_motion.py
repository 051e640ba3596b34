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

from slam_init.frontend.rolling_shutter import readout_places
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.projection.derivatives import moved_pixels
from slam_init.window.state import WindowState
from slam_init.window.tracks import WindowTracks

#: Least number of tracks of a view: three directions determine a rotation.
_LEAST_TRACKS = 3


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
    known = tracks.sweep_px_s.any(axis=2) & tracks.seen & (tracks.anchor >= 0)
    flow = np.zeros_like(tracks.sweep_px_s)
    rho, anchor = state.distances_by_plane(tracks.anchor)[:, None], np.maximum(tracks.anchor, 0)
    points = np.einsum("tji,tj->ti", state.R[anchor], state.rays - rho * state.t[anchor])
    for k in np.flatnonzero(known.sum(axis=1) >= _LEAST_TRACKS):
        i = known[k]
        flow[k, i] = _flow_of_translation(tracks.camera, state.R[k], state.t[k], velocity[k], points[i], rho[i])
    added = flow * readout_places(tracks.camera, tracks.pixels)[..., None]
    # The pixels were corrected for the turning alone.
    return replace(tracks, pixels=tracks.pixels - tracks.readout_s * added, sweep_px_s=tracks.sweep_px_s + added)


def _flow_of_translation(camera: Camera, R: Floats, t: Floats, velocity: Floats, points: Floats, rho: Floats) -> Floats:
    """How the pixels (N, 2) of a view move with the translation of the camera, but for what a rotation explains.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``velocity`` (3,), ``points`` (N, 3), ``rho`` (N, 1).

    * ``points``: In the world, times the inverse distances ``rho`` from their anchors.
    * Returns: In pixels per second; 0 for a point that the lens does not see.
    """
    d = points @ R.T + rho * t
    distances = np.linalg.norm(d, axis=1, keepdims=True)
    d /= np.maximum(distances, 1e-300)
    moved = -rho / np.maximum(distances, 1e-300) * (R @ velocity)
    turn = np.linalg.lstsq(len(d) * np.eye(3) - d.T @ d, np.cross(d, moved).sum(axis=0), rcond=None)[0]
    return np.nan_to_num(moved_pixels(camera, d, moved - np.cross(turn, d)))
