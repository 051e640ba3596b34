"""The compiled inverse of the distortion of a lens (:class:`slam_init.lenses.lens.Bending`)."""

from __future__ import annotations

import numpy as np

from quest.algebra import Floats
from slam_init.lenses.compiler import compiled

#: Newton's method doubles the number of correct digits in each step, and ends where a step is smaller than this. Real
#: lenses need 4 to 8 steps; pixels near the radius at which the lens polynomial stops growing need more.
_STEPS, _SETTLED = 30, 1e-13
#: Largest error of lens coordinates that are distorted again: 1e-7 px for a focal length of 1000 px.
_SOLVED = 1e-10


@compiled
def undistorted(distorted: Floats, start: Floats, bending: Floats, limit: float) -> Floats:
    """Lens coordinates that the distortion moves to given places, by Newton's method.

    Shapes: ``distorted`` (N, 2), ``start`` (N, 2), ``bending`` (13,), returns (N, 3).

    * ``start``: Where the iteration begins.
    * ``limit``: Largest radius.
    * Returns: The coordinates, and the length of (u, v, 1); NaN beyond the limit, where another ray has the same pixel,
      and where the distortion moves the coordinates to another place.
    """
    n1, n2, n3, n4, d1, d2, d3 = bending[0], bending[1], bending[2], bending[3], bending[4], bending[5], bending[6]
    p1, p2, s1, s2, s3, s4 = bending[7], bending[8], bending[9], bending[10], bending[11], bending[12]
    found = np.empty((len(distorted), 3))
    is_ratio = d1 != 0.0 or d2 != 0.0 or d3 != 0.0
    for n in range(len(distorted)):
        x, y = start[n, 0], start[n, 1]
        last, left_x, left_y = 1.0, 0.0, 0.0
        for _ in range(_STEPS + 1):
            r2 = x * x + y * y
            radial = 1 + r2 * (n1 + r2 * (n2 + r2 * (n3 + r2 * n4)))
            slope = n1 + r2 * (2 * n2 + r2 * (3 * n3 + r2 * 4 * n4))
            if is_ratio:
                inverse = 1 / (1 + r2 * (d1 + r2 * (d2 + r2 * d3)))
                radial *= inverse
                slope = (slope - radial * (d1 + r2 * (2 * d2 + r2 * 3 * d3))) * inverse
            left_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2) - distorted[n, 0]
            left_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4) - distorted[n, 1]
            if last < _SETTLED:
                break
            prism_x, prism_y = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
            jxx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
            jyy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
            across = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
            jxy, jyx = across + prism_x * y, across + prism_y * x
            inverse = 1 / (jxx * jyy - jxy * jyx)
            step_x, step_y = (jyy * left_x - jxy * left_y) * inverse, (jxx * left_y - jyx * left_x) * inverse
            x, y, last = x - step_x, y - step_y, max(abs(step_x), abs(step_y))
        r2 = x * x + y * y
        # NaN fails each comparison.
        solved = abs(left_x) < _SOLVED and abs(left_y) < _SOLVED and r2 <= limit * limit
        found[n, 0], found[n, 1], found[n, 2] = (x, y, np.sqrt(r2 + 1)) if solved else (np.nan, np.nan, np.nan)
    return found
