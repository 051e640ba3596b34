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
from slam_init.types.arrays import Bools, Floats
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
    known &= (known.sum(axis=1) >= _LEAST_TRACKS)[:, None]
    flow = _flow_of_translation(tracks, state, np.einsum("kij,kj->ki", state.R, velocity), known)
    added = flow * readout_places(tracks.camera, tracks.pixels)[..., None]
    # The pixels were corrected for the turning alone.
    return replace(tracks, pixels=tracks.pixels - tracks.readout_s * added, sweep_px_s=tracks.sweep_px_s + added)


def _flow_of_translation(tracks: WindowTracks, state: WindowState, velocity: Floats, known: Bools) -> Floats:
    """How the pixels move with the translation of the camera, but for what a rotation explains.

    Shapes: ``velocity`` (V, 3), ``known`` (V, T), returns (V, T, 2).

    * ``velocity``: Of the camera in the axes of the views.
    * ``known``: Observations that turn with the camera.
    * Returns: In pixels per second; 0 for the others, and for points that the lens does not see.
    """
    R, t, anchor = state.R, state.t, np.maximum(tracks.anchor, 0)
    rho = state.distances_by_plane(tracks.anchor)[:, None]
    points = np.einsum("tji,tj->ti", R[anchor], state.rays - rho * t[anchor])
    d = points @ np.swapaxes(R, 1, 2) + rho * t[:, None]
    inverse = 1 / np.sqrt(np.maximum(np.einsum("kti,kti->kt", d, d), 1e-300))[..., None]
    d, by_velocity = d * inverse, -rho * inverse
    used = d * known[..., None]
    # A little more than the information of the rays, which has no inverse where all of them agree.
    information = (known.sum(axis=1) + 1e-9)[:, None, None] * np.eye(3) - np.swapaxes(used, 1, 2) @ used
    pull = np.cross(np.einsum("kto,kti->ki", by_velocity, used), velocity)
    turn = np.linalg.solve(information, pull[..., None])[..., 0]
    moves = by_velocity * velocity[:, None] + d @ np.cross(np.eye(3), turn[:, None])
    flow = tracks.camera.moved_pixels(d.reshape(-1, 3), moves.reshape(-1, 3)).reshape(*known.shape, 2)
    return flow * known[..., None]
