"""The unknowns of a joint fit, what is known of them before, and where a fit starts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.noise import GATE_SIGMAS
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import SAME_LENS, Lens, LensPrior
from slam_init.window.arguments import FIELD_TERMS
from slam_init.window.compiler import compiled
from slam_init.window.tracks import WindowTracks


@dataclass(frozen=True)
class Priors(LensPrior):
    """What is known before the fit."""

    #: Standard deviation of each coefficient of the field of correlated errors of a view, in pixels; 0 for no field.
    field_sigma_px: float = 0.0
    #: Standard deviations of the logarithm of the zoom of a view and of its shift, of a camera that only rotates; 0 for
    #: none. Such views have no field.
    zoom_sigma: float = 0.0
    shift_sigma_px: float = 0.0
    #: An observation counts as an outlier around this number of standard deviations.
    gate_sigmas: float = GATE_SIGMAS
    #: Factor on the probability that the lens changes from view to view.
    lens_changes: float = 1.0


@dataclass(frozen=True, eq=False)
class WindowState:
    """The unknowns of a fit."""

    #: R (V, 3, 3) and t (V, 3): cam_from_world; the world is the frame of view 0.
    R: Floats
    t: Floats
    #: (T, 3) True unit rays in the anchor views.
    rays: Floats
    #: (T,) Along the rays, not negative; not used on the plane.
    inverse_distances: Floats
    lens: Lens
    #: (V, 12) Coefficients of the fields of correlated errors; or the logarithms of the zooms, and the shifts.
    field: Floats
    #: (3,) ``plane . X = 1`` in the world; None without one.
    plane: Floats | None
    #: (T,) Tracks whose point lies on the plane.
    on_plane: Bools

    def with_points_of(self, other: WindowState, some: Bools) -> WindowState:
        """The same state with the points of another one for some of the tracks (T,)."""
        return replace(
            self,
            rays=np.where(some[:, None], other.rays, self.rays),
            inverse_distances=np.where(some, other.inverse_distances, self.inverse_distances),
            on_plane=np.where(some, other.on_plane, self.on_plane),
        )

    def distances_by_plane(self, anchor: Ints) -> Floats:
        """The inverse distances along the rays, of the tracks on the plane by the plane; 0 behind a camera.

        Shapes: ``anchor`` (T,), returns (T,).
        """
        if self.plane is None:
            return self.inverse_distances
        R, t = self.R[np.maximum(anchor, 0)], self.t[np.maximum(anchor, 0)]
        world, centre = np.einsum("tji,tj->ti", R, self.rays), -np.einsum("tji,tj->ti", R, t)
        by_plane = (world @ self.plane) / (1 - centre @ self.plane)
        return np.where(self.on_plane, np.maximum(by_plane, 0.0), self.inverse_distances)


def start_at(
    tracks: WindowTracks,
    R: Floats,
    t: Floats,
    plane: Floats | None = None,
    *,
    lens: Lens = SAME_LENS,
    at_infinity: bool = False,
) -> WindowState:
    """A state at given poses: measured rays, and inverse distances by linear least squares.

    Shapes: ``R`` (V, 3, 3), ``t`` (V, 3), ``plane`` (3,).
    """
    anchor, count = tracks.anchor, len(tracks.anchor)
    if at_infinity:
        rays, inverse = tracks.anchor_rays(lens), np.zeros(count)
        rays = np.where(np.isfinite(rays), rays, tracks.rays)
    else:
        bearings = tracks.bearings(lens)
        rays = bearings[np.maximum(anchor, 0), np.arange(count)]
        rays = np.where(np.isfinite(rays), rays, tracks.rays)
        inverse = triangulated(R, t, bearings, tracks.seen, anchor, rays)
    fields, on_plane = np.zeros((len(R), FIELD_TERMS)), np.full(count, plane is not None)
    return WindowState(R.copy(), t.copy(), rays, inverse, lens, fields, plane, on_plane)


# -- start of the inverse distances ------------------------------------------------------------------------------------


@compiled
def triangulated(R: Floats, t: Floats, bearings: Floats, seen: Bools, anchor: Ints, rays: Floats) -> Floats:
    """Inverse distances along rays, by ``n x (R_k R_a^T (d - rho t_a) + rho t_k) = 0`` for all measured rays n.

    Shapes: ``R`` (V, 3, 3), ``t`` (V, 3), ``bearings`` (V, T, 3), ``seen`` (V, T), ``anchor`` (T,), ``rays`` (T, 3),
    returns (T,).

    * ``anchor``: The view of each ray; tracks with a negative one start in view 0.
    """
    V, T = seen.shape
    inverse = np.zeros(T)
    w, c, f, s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(T):
        a = max(anchor[i], 0)
        for q in range(3):
            w[q] = R[a, 0, q] * rays[i, 0] + R[a, 1, q] * rays[i, 1] + R[a, 2, q] * rays[i, 2]
            c[q] = R[a, 0, q] * t[a, 0] + R[a, 1, q] * t[a, 1] + R[a, 2, q] * t[a, 2]
        numerator, denominator = 0.0, 1e-12
        for k in range(V):
            n0, n1, n2 = bearings[k, i, 0], bearings[k, i, 1], bearings[k, i, 2]
            if not seen[k, i] or k == a or not np.isfinite(n0 + n1 + n2):
                continue
            for p in range(3):
                f[p] = R[k, p, 0] * w[0] + R[k, p, 1] * w[1] + R[k, p, 2] * w[2]
                s[p] = t[k, p] - (R[k, p, 0] * c[0] + R[k, p, 1] * c[1] + R[k, p, 2] * c[2])
            a0, a1, a2 = n1 * f[2] - n2 * f[1], n2 * f[0] - n0 * f[2], n0 * f[1] - n1 * f[0]
            b0, b1, b2 = n1 * s[2] - n2 * s[1], n2 * s[0] - n0 * s[2], n0 * s[1] - n1 * s[0]
            numerator -= a0 * b0 + a1 * b1 + a2 * b2
            denominator += b0 * b0 + b1 * b1 + b2 * b2
        if np.isfinite(numerator / denominator):
            inverse[i] = max(numerator / denominator, 0.0)
    return inverse
