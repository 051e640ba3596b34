"""The unknowns of a joint fit, what is known of them before, and where a fit starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.noise import GATE_SIGMAS
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import SAME_LENS, Lens, LensPrior
from slam_init.window.arguments import FIELD_TERMS
from slam_init.window.inverse_distances import triangulated
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

    def lens_pulls(self, state: WindowState) -> tuple[float, float]:
        """How far the lens is from what is expected, in standard deviations."""
        focal = (state.lens.log_scale - self.mean.log_scale) / self.focal_sigma
        return focal, (state.lens.k1 - self.mean.k1) / self.k1_sigma


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
