"""Errors that neighbouring tracks have in common.

The covariance of a fit assumes that the errors of the tracks are independent. Where the model does not hold in a part
of the view, the residuals of neighbours have the same direction: a moving object that the fit explains in part, a lens
that the calibration does not describe, a tracker that prefers one side. The sum of N errors of variance 1 with
correlations ``rho_ij`` has the variance ``N + sum rho_ij`` over all pairs. Beyond the neighbourhood the correlations
vanish, so that each variance of a fit is too small by the factor ``1 + sum_j rho_ij``: the sum over the neighbours of a
track, on average.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats
from slam_init.window.joint_fit import NEAR_SIGMAS, JointFit
from slam_init.window.kernel import TUKEY_GATES
from slam_init.window.levels import NEIGHBOURHOOD

#: Neighbours that a track is compared with: a moving object holds four tracks or more, or pulls little. The bound is
#: exceeded by chance once in twenty, that many standard deviations beyond the mean.
#: Class: level.
_COMPARED, _BOUND_SIGMAS = 3, 1.645


def variance_by_correlation(fit: JointFit, places: Floats) -> float:
    """Factor on each variance of a fit for the errors that neighbouring tracks share.

    Shapes: ``places`` (T, 2).

    * Returns: At least 1. Without shared errors it exceeds 1 by chance: with 300 tracks in two views by 0.25, in twelve
      views by 0.1.
    """
    tracks = fit.tracks
    near = _neighbours(places, tracks.anchor >= 0)
    squares = np.einsum("vtq,vtq->vt", fit.residuals, fit.residuals)
    used = tracks.seen & (tracks.anchor >= 0) & (squares < TUKEY_GATES * fit.priors.gate_sigmas**2)
    errors = np.where(used[..., None], fit.residuals, 0.0).transpose(1, 0, 2).reshape(len(places), -1)
    total = float(np.sum(errors**2))
    return 1.0 + max(float(np.sum(errors * (near @ errors))) / total, 0.0) if total > 0 else 1.0


def residual_agreement(fit: JointFit, of: Bools, places: Floats) -> float:
    """How far the residuals of some tracks agree with those of their neighbours among them: at most, from 0 to 1.

    Tracks on a moving object agree (0.7 to 1), wrong matches and tracks with more noise than others do not.

    Shapes: ``of`` (T,), ``places`` (T, 2).
    """
    index = np.flatnonzero(of)
    if len(index) <= _COMPARED:
        return 1.0
    squares = np.einsum("vtq,vtq->tv", fit.residuals[:, index], fit.residuals[:, index])
    used = fit.tracks.seen[:, index].T & (squares < NEAR_SIGMAS**2)
    errors = np.where(used[..., None], fit.residuals[:, index].transpose(1, 0, 2), 0.0)
    # Of two tracks the views count that see both.
    lengths = np.sqrt(np.where(used, squares, 0.0) @ used.T.astype(float))
    cosines = np.einsum("ivq,jvq->ij", errors, errors) / np.maximum(lengths * lengths.T, 1e-300)
    apart = np.sum((places[index, None] - places[index]) ** 2, axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = np.argpartition(apart, _COMPARED - 1, axis=1)[:, :_COMPARED]
    of_track = np.take_along_axis(cosines, nearest, axis=1).mean(axis=1)
    bound = float(of_track.mean() + _BOUND_SIGMAS * of_track.std() / np.sqrt(len(index)))
    return min(max(bound, 0.0), 1.0)


def _neighbours(places: Floats, used: Bools) -> Floats:
    """(T, T) ones where the second track is among the nearest of the first."""
    near = np.zeros((len(places), len(places)))
    index = np.flatnonzero(used)
    count = min(max(round(NEIGHBOURHOOD * len(index)), 1), len(index) - 1)
    if count < 1:
        return near
    x, y = places[index].T
    squares = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    np.fill_diagonal(squares, np.inf)
    nearest = np.argpartition(squares, count - 1, axis=1)[:, :count]
    near[index[:, None], index[nearest]] = 1.0
    return near
