"""The arguments of the compiled loops of the joint fit: named tuples of arrays.

The loops go through the tracks in blocks of :data:`slam_init.window.rows.LANES`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.rows import COLUMNS, LANES, PROJECTED_ROWS, TRACK_ROWS

#: Coefficients of the field of correlated errors of a view: 1, u, v, u^2, uv, v^2 for each component of the pixel.
FIELD_TERMS = 12
#: In place of a field, a view of a camera that rotates has the logarithm of its zoom, and its shift in pixels.
ZOOM_TERMS = 3


class Observed(NamedTuple):
    """The observations of the tracks that take part: the same at all states."""

    #: (B, LANES) The tracks of each block. Lanes beyond the last track repeat the first one, and no view sees them.
    tracks: Ints
    #: (B,) The view in which the tracks of a block are first seen, and their number.
    anchors: Ints
    counts: Ints
    #: (B * V, OBSERVED_ROWS * LANES)
    rows: Floats
    #: The squared outlier gate.
    gate2: float


class Unknowns(NamedTuple):
    """A state, whose arrays receive the steps of a fit; which tracks are on the plane stays as it is."""

    #: R, t: (V, 3, 3), (V, 3)
    R: Floats
    t: Floats
    #: (V, 12) Of a field, or the zoom and the shift of a view.
    field: Floats
    #: (3,)
    plane: Floats
    #: (T, 3)
    rays: Floats
    #: (T,)
    inverse_distances: Floats
    #: (5,) Logarithm of the true focal length over the stated one, k1, readout in seconds, and principal point.
    lens: Floats
    #: (T,)
    on_plane: Bools


class Known(NamedTuple):
    """What is known before the tracks are seen."""

    #: (31,) See :attr:`slam_init.types.camera.Camera.numbers`.
    camera: Floats
    #: Readout that the pixels are corrected for.
    corrected_s: float
    #: Whether all points are at infinity.
    at_infinity: bool
    #: (G,) One over the variance of each common unknown.
    weights: Floats
    #: (5,) What is expected of the lens, in the order of :attr:`Unknowns.lens`.
    lens: Floats
    #: turned, turned_weights: (V, 3, 3), (V,) Measured rotations of the views from the first one, and one over their
    #: variances, rad^-2; 0 where nothing was measured.
    turned: Floats
    turned_weights: Floats


class Layout(NamedTuple):
    """The order of the common unknowns."""

    #: Coefficients of the field of correlated errors of a view: none, or :data:`FIELD_TERMS`. :data:`ZOOM_TERMS` where
    #: the view zooms and shifts.
    field: int
    #: Whether the readout is an unknown, and the number of coordinates of the principal point that are.
    readout: int
    principal: int

    #: Unknowns of a pose: rotation vector and translation, or the rotation alone.
    pose: int
    #: Unknowns of a view: pose, then field. View 0 has a field and no pose.
    block: int
    #: Place of the focal length, and number of unknowns of the lens.
    focal: int
    lens: int
    #: Place of the plane, if it is an unknown.
    plane: int

    @staticmethod
    def of(views: int, *, field: int, readout: bool, principal: bool, rotation_only: bool = False) -> Layout:
        """The order for a number of views and for what is unknown; points at infinity show no translation."""
        pose = 3 if rotation_only else 6
        block = pose + field
        focal, lens = block * (views - 1) + field, 2 + readout + 2 * principal
        return Layout(field, int(readout), 2 * principal, pose, block, focal, lens, focal + lens)


class Limits(NamedTuple):
    """Where a fit ends, see :func:`slam_init.window.joint_fit.fit_window`."""

    max_steps: int
    tolerance: float
    hopeless: float
    give_up: float


class Equations(NamedTuple):
    """Receives the cost of each track, and the equations of a step with G common unknowns."""

    #: (G, G) Normal matrix of the common unknowns, the tracks eliminated. With tracks on the plane the last three
    #: unknowns are those of the plane.
    normal: Floats
    #: (G,)
    gradient: Floats
    #: (T,) With the cost of leaving the plane.
    costs: Floats
    #: (V, T, 2) The residual of each observation in units of the noise; infinite behind a camera.
    residuals: Floats
    #: (T,) Tracks whose inverse distance is an unknown of its own.
    free: Bools
    #: (T,) How much the cost of a track with a free distance would fall if its point moved across its epipolar lines,
    #: in proportion to what a distance moves it along them. A rigid scene does not move so: this is chance.
    across: Floats
    #: own, inverses: (T, 3), (T, 3, 3) Gradient of each track by its unknowns (two of its ray, and the inverse
    #: distance), and the inverse of its equations; zero by a distance that is none.
    own: Floats
    inverses: Floats
    #: (B * G, 4 * LANES) How the gradient of each track follows the common unknowns, in the axes of the world; then its
    #: share in the gradient of the common unknowns, the track eliminated.
    coupled: Floats

    @staticmethod
    def empty(blocks: int, views: int, tracks: int, size: int) -> Equations:
        """Place for a number of blocks, of views, of tracks and of common unknowns."""
        return Equations(
            np.zeros((size, size)), np.zeros(size), np.zeros(tracks), np.zeros((views, tracks, 2)),
            np.zeros(tracks, bool), np.zeros(tracks), np.zeros((tracks, 3)), np.zeros((tracks, 3, 3)),
            np.zeros((blocks * size, 4 * LANES)),
        )  # fmt: skip


class Room(NamedTuple):
    """Room for a block of tracks, and for the solution of the equations: the loops make no arrays."""

    #: Rows of the tracks, of their projections into a view, and of the derivatives of the residuals.
    tracks: Floats
    projected: Floats
    columns: Floats
    #: The last ones, as rows (COLUMNS, 2 * LANES) of the same memory.
    table: Floats
    #: (G + 1, 3 * LANES) Coupling and gradient of each track, over a root of its equations.
    halves: Floats
    #: (30,) The derivatives that an observation has, and the common unknowns that they are by.
    slots: Ints
    places: Ints
    #: (G, G), (G,) The upper half of the first is factorized.
    factor: Floats
    step: Floats
    #: (G,) The step with its poses in the axes of the world.
    turned: Floats

    @staticmethod
    def empty(size: int) -> Room:
        """Room for G common unknowns."""
        tracks, projected, columns = (np.zeros(rows * LANES) for rows in (TRACK_ROWS, PROJECTED_ROWS, 2 * COLUMNS))
        places = np.zeros(COLUMNS, np.int64), np.zeros(COLUMNS, np.int64)
        return Room(
            tracks,
            projected,
            columns,
            columns.reshape(COLUMNS, -1),
            np.zeros((size + 1, 3 * LANES)),
            *places,
            np.zeros((size, size)),
            np.zeros(size),
            np.zeros(size),
        )
