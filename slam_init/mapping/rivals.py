"""The largest cost of a track that a map explains."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats, Ints

__all__ = ["explained_at_most"]


def explained_at_most(freedom: Ints) -> Floats:
    """Return the largest cost of a track that a map explains; larger costs are truncated to it.

    A track that neither of two maps explains must have the same cost in both maps. Otherwise outliers would vote, each
    one by chance but with a large weight. The bound is the mean of chi-square plus five of its standard deviations; one
    correct track in a thousand exceeds it.

    Parameters
    ----------
    freedom : (T,) int
        Degrees of freedom of each track.

    Returns
    -------
    (T,) float
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))
