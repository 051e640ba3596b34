"""The rows of a block of tracks in the compiled loops of the joint fit.

A block is :data:`LANES` tracks that are first seen by the same view. All that the loops hold of it is rows of LANES
numbers, one for each track, in one flat array. A constant is the place of the first number of a row, or of each row of
a vector. So a processor works on several tracks at once, since it knows that no two rows overlap.
"""

from __future__ import annotations

#: Tracks of a block: four or eight vectors of a processor.
LANES = 32


def _rows(first: int, count: int, height: int = 1) -> tuple[int, ...]:
    return tuple(LANES * height * row for row in range(first, first + count))


# Rows of slam_init.window.arguments.Observed.rows for a block and a view.

#: Whether the view sees the track.
SEEN = 0
#: The measured pixel, and its derivative by the readout.
PIXEL, SWEEP = _rows(1, 2), _rows(3, 2)
#: The matrix that turns an offset of the pixel into units of the noise: xx, xy, yy.
WHITEN = _rows(5, 3)
#: The polynomials of the field at the measured pixel.
PLACES = _rows(8, 6)
OBSERVED_ROWS = 14

# Rows of slam_init.window.arguments.Room.tracks.

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

# Rows of slam_init.window.arguments.Room.projected.

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

# Columns of slam_init.window.arguments.Room.columns: two rows each, for the two residuals of an observation, times the
# root of their weight.

#: The residuals, and their derivatives by the unknowns of the track, by the lens, by the poses of the view and of the
#: anchor, by the plane, and by the field of the view: the number of the first column.
RESIDUALS, TRACK, LENS, VIEW, ANCHOR, PLANE, FIELD, COLUMNS = 0, 1, 4, 9, 15, 21, 24, 36
#: The first rows of these columns.
OF_RESIDUALS, OF_TRACK, OF_LENS = 0, _rows(TRACK, 3, 2), _rows(LENS, 5, 2)
OF_VIEW, OF_ANCHOR, OF_PLANE = _rows(VIEW, 6, 2), _rows(ANCHOR, 6, 2), _rows(PLANE, 3, 2)
