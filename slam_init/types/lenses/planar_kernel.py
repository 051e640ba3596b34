"""The compiled loop of :meth:`slam_init.types.lenses.lens.RadialTangentialLens.undistort`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.jit import compiler_of
from slam_init.types.arrays import Floats

compiled = compiler_of(Path(__file__).parent)

#: Newton's method doubles the number of correct digits in each step, and ends where a step is smaller than this. Real
#: lenses need 4 to 8 steps; pixels near the radius at which the lens polynomial stops growing need more.
_STEPS, _SETTLED = 30, 1e-13


@compiled
def undistorted(distorted: Floats, coefficients: Floats, largest_residual: float) -> Floats:
    """Points of the plane that a radial-tangential lens puts at given places, by Newton's method from these places.

    Shapes: ``distorted`` (N, 2), ``coefficients`` (5,), returns (N, 2).

    * ``coefficients``: k1, k2, p1, p2, k3.
    * Returns: NaN where the lens puts the point farther from its place than the largest residual.
    """
    k1, k2, p1, p2, k3 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    found = np.empty_like(distorted)
    for n in range(len(distorted)):
        x, y = distorted[n, 0], distorted[n, 1]
        step_x, step_y, left_x, left_y = np.inf, np.inf, np.inf, np.inf
        for last in range(_STEPS + 1):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            left_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - distorted[n, 0]
            left_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - distorted[n, 1]
            if last == _STEPS or (abs(step_x) < _SETTLED and abs(step_y) < _SETTLED):
                break
            slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d r2, times 2
            jxx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
            jxy = x * y * slope + 2 * p1 * x + 2 * p2 * y
            jyy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
            determinant = jxx * jyy - jxy * jxy
            step_x = (jyy * left_x - jxy * left_y) / determinant
            step_y = (jxx * left_y - jxy * left_x) / determinant
            x, y = x - step_x, y - step_y
        solved = abs(left_x) < largest_residual and abs(left_y) < largest_residual
        found[n, 0], found[n, 1] = (x, y) if solved else (np.nan, np.nan)
    return found
