"""The arguments of the compiled loops of the joint fit: named tuples of arrays, and the rows of a block of tracks.

A block is :data:`LANES` tracks that are first seen by the same view. All that the loops hold of it is rows of LANES
numbers, one for each track, in one flat array. A constant is the place of the first number of a row, or of each row of
a vector. So a processor works on several tracks at once, since it knows that no two rows overlap.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled, part

#: Coefficients of the field of correlated errors of a view: 1, u, v, u^2, uv, v^2 for each component of the pixel.
FIELD_TERMS = 12
#: In place of a field, a view of a camera that rotates has the logarithm of its zoom, and its shift in pixels.
ZOOM_TERMS = 3
#: Tracks of a block: four or eight vectors of a processor.
LANES = 32


def _rows(first: int, count: int, height: int = 1) -> tuple[int, ...]:
    return tuple(LANES * height * row for row in range(first, first + count))


# Rows of Observed.rows for a block and a view.

#: Whether the view sees the track.
SEEN = 0
#: The measured pixel, and its derivative by the readout.
PIXEL, SWEEP = _rows(1, 2), _rows(3, 2)
#: The matrix that turns an offset of the pixel into units of the noise: xx, xy, yy.
WHITEN = _rows(5, 3)
#: The polynomials of the field at the measured pixel.
PLACES = _rows(8, 6)
OBSERVED_ROWS = 14

# Rows of Room.tracks.

#: The point times the inverse distance, in the axes of the world from the origin on, and the inverse distance.
POINT, RHO = _rows(0, 3), 3 * LANES
#: The tangents of the ray in the axes of the world, and how the inverse distance follows them on a plane.
TANGENT_X, TANGENT_Y, BY_TANGENTS = _rows(4, 3), _rows(7, 3), _rows(10, 2)
#: Whether the track is on the plane, has a distance of its own, and lies ahead of its anchor: 1 or 0.
ON_PLANE, FREE, AHEAD = _rows(12, 3)
#: Derivatives of the inverse distance by the plane and by the pose of the anchor.
BY_PLANE, BY_ANCHOR = _rows(15, 3), _rows(18, 6)
#: The equations of the track (xx, xy, xz, yy, yz, zz), and its gradient.
OWN, GRADIENT = _rows(24, 6), _rows(30, 3)
#: Slope and curvature of the cost across the epipolar lines, and the cost.
SLOPE, CURVATURE, COST = _rows(33, 3)
#: The root L of the equations of the track: 1 / L00, L10, 1 / L11, L20, L21, 1 / L22.
ROOT = _rows(36, 6)
TRACK_ROWS = 42

# Rows of Room.projected.

#: Whether the lens sees the point: 1 or 0.
SEES = 0
#: The pixel of the point, then how far it is from the measured one.
OFFSET = _rows(1, 2)
#: Derivatives of the pixel by the logarithm of the focal length and by k1.
BY_FOCAL, BY_K1 = _rows(3, 2), _rows(5, 2)
#: Derivatives of its two coordinates by the point.
X_BY_POINT, Y_BY_POINT = _rows(7, 3), _rows(10, 3)
#: Residual in units of the noise, and the root of its weight.
RESIDUAL, ROOT_WEIGHT = _rows(13, 2), 15 * LANES
PROJECTED_ROWS = 16

# Columns of Room.columns: two rows each, for the two residuals of an observation, times the root of their weight.

#: The residuals, and their derivatives by the unknowns of the track, by the lens, by the poses of the view and of the
#: anchor, by the plane, and by the field of the view: the number of the first column.
RESIDUALS, TRACK, LENS, VIEW, ANCHOR, PLANE, FIELD, COLUMNS = 0, 1, 4, 9, 15, 21, 24, 36
#: The first rows of these columns.
OF_RESIDUALS, OF_TRACK, OF_LENS = 0, _rows(TRACK, 3, 2), _rows(LENS, 5, 2)
OF_VIEW, OF_ANCHOR, OF_PLANE = _rows(VIEW, 6, 2), _rows(ANCHOR, 6, 2), _rows(PLANE, 3, 2)


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


class Problem(NamedTuple):
    """What a fit is made of, the same at all states."""

    observed: Observed
    known: Known
    layout: Layout


class Limits(NamedTuple):
    """Where a fit ends.

    Without the last two the frame with the map takes .7 longer before the checkerboard and .25 in the hospital, since
    most of their motions and their camera that only rotates cannot win.
    """

    #: Largest number of steps of a fit that starts near the answer.
    max_steps: int = 12
    #: A step lowers the cost by less: a fortieth of a nat is far below what decides.
    tolerance: float = 0.05
    #: The steps to come cannot lower the cost to this.
    hopeless: float = math.inf
    #: A step leaves the cost above this.
    give_up: float = math.inf


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
        table, halves = columns.reshape(COLUMNS, -1), np.zeros((size + 1, 3 * LANES))
        slots, places = np.zeros(COLUMNS, np.int64), np.zeros(COLUMNS, np.int64)
        factor, step, turned = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        return Room(tracks, projected, columns, table, halves, slots, places, factor, step, turned)


# -- the observations of blocks of tracks ------------------------------------------------------------------------------


@part
def _list_blocks(anchor: Ints, views: int) -> tuple[Ints, Ints, Ints]:
    """List the tracks that take part in blocks with one anchor view each.

    Shapes: ``anchor`` (T,), returns (B, LANES), returns (B,), returns (B,).

    * Returns: Tracks, anchors and counts of :class:`Observed`.
    """
    blocks, most = 0, len(anchor) // LANES + views
    tracks, anchors, counts = np.empty((most, LANES), np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    for a in range(views):
        count = LANES
        for i in range(len(anchor)):
            if anchor[i] != a:
                continue
            if count == LANES:
                anchors[blocks] = a
                for lane in range(LANES):
                    tracks[blocks, lane] = i
                blocks, count = blocks + 1, 0
            tracks[blocks - 1, count] = i
            count += 1
            counts[blocks - 1] = count
    return tracks[:blocks], anchors[:blocks], counts[:blocks]


@compiled
def gather(
    anchor: Ints,
    seen: Bools,
    pixels: Floats,
    sigma_px: Floats,
    whitening: Floats,
    sweep_px_s: Floats,
    places: Floats,
    has_fields: bool,
) -> tuple[Ints, Ints, Ints, Floats]:
    """Gather the observations of the tracks that take part, in blocks with one anchor view each.

    Shapes: those of :class:`slam_init.window.tracks.WindowTracks`.

    * Returns: The arrays of :class:`Observed`.
    """
    tracks, anchors, counts = _list_blocks(anchor, len(seen))
    out = np.empty((len(tracks) * len(seen), OBSERVED_ROWS * LANES))
    for b in range(len(tracks)):
        for k in range(len(seen)):
            n = b * len(seen) + k
            for lane in range(LANES):
                i = tracks[b, lane]
                inverse = 1.0 / sigma_px[k, i]
                out[n, SEEN + lane] = 1.0 if lane < counts[b] and seen[k, i] else 0.0
                out[n, PIXEL[0] + lane], out[n, PIXEL[1] + lane] = pixels[k, i, 0], pixels[k, i, 1]
                out[n, SWEEP[0] + lane], out[n, SWEEP[1] + lane] = sweep_px_s[k, i, 0], sweep_px_s[k, i, 1]
                out[n, WHITEN[0] + lane] = whitening[k, i, 0, 0] * inverse
                out[n, WHITEN[1] + lane] = whitening[k, i, 0, 1] * inverse
                out[n, WHITEN[2] + lane] = whitening[k, i, 1, 1] * inverse
                for q in range(6 if has_fields else 0):
                    out[n, PLACES[q] + lane] = places[k, i, q] * sigma_px[k, i]
    return tracks, anchors, counts, out
