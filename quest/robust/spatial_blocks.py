"""Neighbouring matches share errors (drift of a tracker, lens, blur, a moving body): how far a sum over them scatters.

A sum over N independent matches fluctuates by the root of its sum of squares. Where neighbours err alike it fluctuates
by more: by that of the sums over regions of the view.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["directions_of", "regions_of", "scatter_of_sum"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Regions of the view, across and down: as small as a body or a patch of texture.
_REGIONS = (8, 6)


def directions_of(rays: Floats) -> Floats:
    """Stereographic coordinates (N, 2) of unit rays (N, 3): neighbours stay neighbours, in all of the sphere."""
    return np.asarray(rays[:, :2] / np.maximum(1 + rays[:, 2:], 1e-9))


def regions_of(where: Floats, shape: tuple[int, int] = _REGIONS) -> Ints:
    """The region of the view (N,) of matches that were seen at (N, 2); the view is what 98 % of them fill."""
    if len(where) == 0:
        return np.zeros(0, np.int64)
    low, high = np.percentile(where, [1, 99], axis=0)
    cells = np.clip((where - low) / np.maximum(high - low, 1e-12) * shape, 0, np.array(shape) - 1).astype(int)
    return np.asarray(cells[:, 0] * shape[1] + cells[:, 1])


def scatter_of_sum(values: Floats, where: Floats) -> float:
    """Standard deviation of the sum of values (N,) at (N, 2) whose neighbours err alike, if its expectation is zero.

    It is that of the sums over regions of the view, where that is larger than the one of single values. Errors that
    reach farther than a region are not known by it; with regions twice as large, what two planes predict differently in
    different parts of the view was taken for such errors, and one plane in twenty more stayed undecided.
    """
    if len(values) == 0:
        return 0.0
    region = regions_of(where)
    # What the regions say beside their share of the total: where all of them agree there is nothing left.
    sums = np.bincount(region, weights=values) - np.bincount(region) * values.mean()
    return float(np.sqrt(max(np.sum(values**2), np.sum(sums**2))))
