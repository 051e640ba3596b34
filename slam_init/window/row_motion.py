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

from quest.algebra import solve_in_place
from slam_init.frontend.rolling_shutter import readout_places
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled
from slam_init.window.projection import camera_vector, project_point
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
    known = tracks.sweep_px_s.any(axis=2) & tracks.seen & (tracks.anchor >= 0)
    flow = np.zeros_like(tracks.sweep_px_s)
    _flow_of_translation(
        camera_vector(tracks.camera), state.R, state.t, velocity, tracks.anchor, state.rays,
        state.distances_by_plane(tracks.anchor), known, flow,
    )  # fmt: skip
    added = flow * readout_places(tracks.camera, tracks.pixels)[..., None]
    # The pixels were corrected for the turning alone.
    return replace(tracks, pixels=tracks.pixels - tracks.readout_s * added, sweep_px_s=tracks.sweep_px_s + added)


@compiled
def _flow_of_translation(
    camera: Floats,
    R: Floats,
    t: Floats,
    velocity: Floats,
    anchor: Ints,
    rays: Floats,
    rho: Floats,
    known: Bools,
    flow: Floats,
) -> None:
    """How pixels move with the translation of the camera, but for what a rotation explains.

    Shapes: ``camera`` (31,), ``R`` (V, 3, 3), ``t`` (V, 3), ``velocity`` (V, 3), ``anchor`` (T,), ``rays`` (T, 3),
    ``rho`` (T,), ``known`` (V, T), ``flow`` (V, T, 2).

    * ``flow``: Receives pixels per second; it stays where fewer than three tracks of a view are known.
    """
    V, T = known.shape
    d, moved = np.empty((T, 3)), np.empty((T, 3))
    A, b, u, w = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for k in range(V):
        count = 0
        for p in range(3):
            b[p] = 0.0
            u[p] = R[k, p, 0] * velocity[k, 0] + R[k, p, 1] * velocity[k, 1] + R[k, p, 2] * velocity[k, 2]
            for q in range(3):
                A[p, q] = 0.0
        for i in range(T):
            if not known[k, i]:
                continue
            a, r = anchor[i], rho[i]
            for p in range(3):
                w[p] = 0.0
                for q in range(3):
                    w[p] += R[a, q, p] * (rays[i, q] - r * t[a, q])
            norm = 0.0
            for p in range(3):
                d[i, p] = R[k, p, 0] * w[0] + R[k, p, 1] * w[1] + R[k, p, 2] * w[2] + r * t[k, p]
                norm += d[i, p] * d[i, p]
            norm = max(np.sqrt(norm), 1e-300)
            count += 1
            for p in range(3):
                d[i, p] /= norm
                moved[i, p] = -r / norm * u[p]
            b[0] += d[i, 1] * moved[i, 2] - d[i, 2] * moved[i, 1]
            b[1] += d[i, 2] * moved[i, 0] - d[i, 0] * moved[i, 2]
            b[2] += d[i, 0] * moved[i, 1] - d[i, 1] * moved[i, 0]
            for p in range(3):
                A[p, p] += 1.0
                for q in range(3):
                    A[p, q] -= d[i, p] * d[i, q]
        if count < 3 or not solve_in_place(A, b):
            continue
        for i in range(T):
            if not known[k, i]:
                continue
            m0 = moved[i, 0] - (b[1] * d[i, 2] - b[2] * d[i, 1])
            m1 = moved[i, 1] - (b[2] * d[i, 0] - b[0] * d[i, 2])
            m2 = moved[i, 2] - (b[0] * d[i, 1] - b[1] * d[i, 0])
            seen, _, _, a0, a1, a2, b0, b1, b2, _, _ = project_point(camera, 1.0, 0.0, d[i, 0], d[i, 1], d[i, 2])
            if seen:
                flow[k, i, 0] = a0 * m0 + a1 * m1 + a2 * m2
                flow[k, i, 1] = b0 * m0 + b1 * m1 + b2 * m2
