"""The scatter of a sum over matches whose errors are correlated between neighbours.

Neighbouring matches share errors: drift of a tracker, distortion of the lens, blur, a moving object. The sum over N
independent matches has the standard deviation sqrt(sum of squares). With correlated errors the standard deviation is
larger. It is then that of the sums over regions of the view.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Number of regions of the view, across and down: a region is as small as a moving object or a patch of texture.
_REGIONS = (8, 6)


def directions_of(rays: Floats) -> Floats:
    """Stereographic coordinates of rays: neighbours on the sphere are neighbours in the plane.

    Shapes: ``rays`` (N, 3), returns (N, 2).
    """
    return np.asarray(rays[:, :2] / np.maximum(1 + rays[:, 2:], 1e-9))


def regions_of(where: Floats, shape: tuple[int, int] = _REGIONS) -> Ints:
    """The region of the view in which each match lies; the view is the rectangle that 98 % of the matches fill.

    Shapes: ``where`` (N, 2), ``shape`` (int, int), returns (N,).
    """
    if len(where) == 0:
        return np.zeros(0, np.int64)
    low, high = percentiles(where)
    cells = np.clip((where - low) / np.maximum(high - low, 1e-12) * shape, 0, np.array(shape) - 1).astype(int)
    return np.asarray(cells[:, 0] * shape[1] + cells[:, 1])


def percentiles(values: Floats) -> tuple[Floats, Floats]:
    """The 1st and the 99th percentile of each column."""
    low, high = np.quantile(values, (0.01, 0.99), axis=0)
    return low, high


def scatter_of_sum(values: Floats, where: Floats) -> float:
    """Standard deviation of a sum of values with correlated errors, if the expectation of the sum is zero.

    The larger of two estimates: from single values, and from sums over regions of the view. Errors that are correlated
    over more than a region are not included. With regions twice as large, the difference that two planes predict
    between parts of the view was counted as such errors, and one plane in twenty more stayed undecided.

    Shapes: ``values`` (N,), ``where`` (N, 2).
    """
    if len(values) == 0:
        return 0.0
    region = regions_of(where)
    # Each sum less its share of the total: zero where all regions agree.
    sums = np.bincount(region, weights=values) - np.bincount(region) * values.mean()
    return float(np.sqrt(max(np.sum(values**2), np.sum(sums**2))))
