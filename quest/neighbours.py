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

#: Regions of the view, across and down: small against a lens and a body, large enough to hold some matches.
_REGIONS = (8, 6)


def directions_of(rays: Floats) -> Floats:
    """Stereographic coordinates (N, 2) of unit rays (N, 3): neighbours stay neighbours, in all of the sphere."""
    return np.asarray(rays[:, :2] / np.maximum(1 + rays[:, 2:], 1e-9))


def regions_of(where: Floats) -> Ints:
    """The region of the view (N,) of matches that were seen at (N, 2); the view is what 98 % of them fill."""
    low, high = np.percentile(where, [1, 99], axis=0)
    cells = np.clip((where - low) / np.maximum(high - low, 1e-12) * _REGIONS, 0, np.array(_REGIONS) - 1).astype(int)
    return np.asarray(cells[:, 0] * _REGIONS[1] + cells[:, 1])


def scatter_of_sum(values: Floats, region: Ints) -> float:
    """Standard deviation of the sum of values (N,) whose neighbours err alike, under the hypothesis that it is zero.

    It is that of the sums over regions, where that is larger than the one of single values.
    """
    # What the regions say beside their share of the total: where all of them agree there is nothing left.
    sums = np.bincount(region, weights=values) - np.bincount(region) * values.mean()
    return float(np.sqrt(max(np.sum(values**2), np.sum(sums**2))))
