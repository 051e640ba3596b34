"""The compiled inverse of the distortion of a lens (:class:`slam_init.types.lenses.lens.Bending`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.jit import compiler_of
from slam_init.types.arrays import Floats

compiled = compiler_of(Path(__file__).parent)

#: Newton's method doubles the number of correct digits in each step, and ends where a step is smaller than this. Real
#: lenses need 4 to 8 steps; pixels near the radius at which the lens polynomial stops growing need more.
_STEPS, _SETTLED = 30, 1e-13
#: Largest error of lens coordinates that are distorted again: 1e-7 px for a focal length of 1000 px.
_SOLVED = 1e-10


@compiled
def undistorted(distorted: Floats, start: Floats, bending: Floats) -> Floats:
    """Lens coordinates that the distortion moves to given places, by Newton's method.

    Shapes: ``distorted`` (N, 2), ``start`` (N, 2), ``bending`` (13,), returns (N, 2).

    * ``start``: Where the iteration begins; it is overwritten.
    * Returns: NaN where the distortion moves the coordinates to another place.
    """
    n1, n2, n3, n4, d1, d2, d3, p1, p2, s1, s2, s3, s4 = bending
    for n in range(len(distorted)):
        x, y = start[n, 0], start[n, 1]
        step_x, step_y, left_x, left_y = np.inf, np.inf, np.inf, np.inf
        for last in range(_STEPS + 1):
            r2 = x * x + y * y
            N, D = 1 + r2 * (n1 + r2 * (n2 + r2 * (n3 + r2 * n4))), 1 + r2 * (d1 + r2 * (d2 + r2 * d3))
            radial = N / D
            left_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2) - distorted[n, 0]
            left_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4) - distorted[n, 1]
            if last == _STEPS or (abs(step_x) < _SETTLED and abs(step_y) < _SETTLED):
                break
            N_r2, D_r2 = n1 + r2 * (2 * n2 + r2 * 3 * n3 + r2 * r2 * 4 * n4), d1 + r2 * (2 * d2 + r2 * 3 * d3)
            slope = 2 * ((N_r2 - radial * D_r2) / D)  # d radial / d r2, times 2
            prism_x, prism_y = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
            jxx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
            jyy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
            across = x * y * slope + 2 * p1 * x + 2 * p2 * y
            jxy, jyx = across + prism_x * y, across + prism_y * x
            determinant = jxx * jyy - jxy * jyx
            step_x = (jyy * left_x - jxy * left_y) / determinant
            step_y = (jxx * left_y - jyx * left_x) / determinant
            x, y = x - step_x, y - step_y
        solved = abs(left_x) < _SOLVED and abs(left_y) < _SOLVED
        start[n, 0], start[n, 1] = (x, y) if solved else (np.nan, np.nan)
    return start
