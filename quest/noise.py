"""The noise of the bearings, the last refinement of a motion, and the choice between motions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels
from quest.robust.lo_ransac import RansacReport
from quest.robust.loss import REACH, SCALE, log_likelihoods
from quest.robust.pose_problem import PoseProblem, distinct_modes

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
GATE_SIGMAS = 3.0
#: Scale of the loss of the last refinement, in standard deviations of the noise. Errors of normal noise are larger than
#: those of least squares by 7 % then, by 46 % with the scale of the search where the threshold is three deviations. On
#: 391 real pairs the AUC is within .3 %.
KERNEL_SIGMAS = 1.5
#: Number of unknowns of a motion.
_UNKNOWNS = 5
#: Smallest noise, in thresholds: it keeps the gates of exact data open.
_LEAST_NOISE = 1e-3
#: Largest number of other modes of the search that are compared with the best, and of matches that compare them.
_MODES, MOST_COMPARED = 4, 500
#: Largest number of steps of a refinement.
_STEPS = 25
#: By so much the likelihood of five unknowns differs from its maximum within their noise: half of the chi-square that
#: is exceeded once in a thousand.
SAME_FIT_NATS = 10.3
#: Fewer matches than this are not sorted by their depth.
LEAST_TYPICAL = 8


def best_of_modes(
    problem: PoseProblem, report: RansacReport, inliers: int, rng: np.random.Generator
) -> tuple[Floats, float, list[Floats]]:
    """The refined motion (q_wxyz, t) of the largest likelihood among the modes of a search, its noise, and the others.

    The search compares motions by the threshold, before they are refined.

    * ``inliers``: Number of matches that the best motion of the search explains. A raw model that misses half of them
      is left out.
    """
    near = np.flatnonzero(report.costs[1:] - report.costs[0] < 0.5 * inliers * problem.threshold_rad**2)
    some = problem
    if len(near) > 0 and len(problem) > MOST_COMPARED:
        rows = rng.permutation(len(problem))[:MOST_COMPARED]
        some = PoseProblem(problem.m[rows], problem.n[rows], problem.threshold_rad)
    # Most raw models lead to the optimum that is known.
    models = distinct_modes(refine_motion(some, report.models[k]) for k in (0, *(1 + near[:_MODES])))
    models.sort(key=lambda model: -log_likelihood(some, model))
    return *refine_with_noise(problem, models[0]), models[1:]


def log_likelihood(problem: PoseProblem, model: Floats) -> float:
    """Logarithm of the likelihood of a motion (q_wxyz, t), less that of outliers alone."""
    return float(log_likelihoods_of(problem, model).sum())


def log_likelihoods_of(problem: PoseProblem, model: Floats) -> Floats:
    """The part of each match (N,) in :func:`log_likelihood`."""
    r, threshold_rad = np.sqrt(problem.residuals(model)), problem.threshold_rad
    return np.where(r < REACH * threshold_rad, log_likelihoods(r, SCALE * threshold_rad), 0.0)


def refine_motion(problem: PoseProblem, model: Floats) -> Floats:
    """Refine a motion (q_wxyz, t) by maximum likelihood, see :mod:`quest.robust.loss`."""
    stage = problem.threshold_rad * np.array([(REACH, SCALE)])
    return kernels.climb(problem.m, problem.n, model, problem.threshold_rad, stage, len(problem), _STEPS)[0]


def _of_typical_depth(problem: PoseProblem, model: Floats) -> Floats:
    """The motion refined without matches of untypical depth, unless the likelihood of all matches contradicts it.

    An outlier that fits a motion by chance lies anywhere on its epipolar line, and with a long lever. A foreground is
    of untypical depth as well, and then the likelihood falls by more than the noise of the motion explains.
    """
    R, t = kernels.rotation_of_model(model), model[4:]
    typical = problem.explained(model, REACH * problem.threshold_rad)
    kernels.mark_typical(problem.m, problem.n, R, t, typical)
    if typical.sum() < LEAST_TYPICAL:
        return model
    refined = _refined_on(problem, model, typical, SCALE * problem.threshold_rad)
    return refined if log_likelihood(problem, refined) > log_likelihood(problem, model) - SAME_FIT_NATS else model


def refine_with_noise(problem: PoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine a motion (q_wxyz, t); return the motion and the noise that its residuals show.

    The noise is the standard deviation of a bearing, from the median absolute residual; at least a thousandth of the
    threshold. Matches of untypical depth do not take part in it: an outlier that fits a motion by chance lies anywhere
    on its epipolar line, while with little parallax the points of the scene lie within a few pixels of their lines. The
    last refinement has the scale of this noise, where it is wider than that of the search.

    P. J. Rousseeuw and A. M. Leroy, "Robust Regression and Outlier Detection", 1987, section 5.1: the factor for small
    samples.
    """
    model, threshold_rad = _of_typical_depth(problem, refine_motion(problem, model)), problem.threshold_rad
    count, median_rad = kernels.typical_noise(problem.m, problem.n, model, threshold_rad)
    if count < _UNKNOWNS + 1:
        return model, threshold_rad / GATE_SIGMAS
    # The motion has adapted to few matches. 1.4826 times the median absolute deviation is the deviation of a Gaussian.
    few_matches = 1 + _UNKNOWNS / max(count - _UNKNOWNS, 1)
    noise_rad = max(1.4826 * few_matches * median_rad, _LEAST_NOISE * threshold_rad)
    scale_rad = max(KERNEL_SIGMAS * noise_rad, SCALE * threshold_rad)
    return _refined_on(problem, model, problem.explained(model, REACH * threshold_rad), scale_rad), noise_rad


def _refined_on(problem: PoseProblem, model: Floats, use: Bools, scale_rad: float) -> Floats:
    """The motion refined on some of the matches (N,)."""
    R, t = kernels.rotation_of_model(model), model[4:].copy()
    kernels.refine(problem.m, problem.n, use, R, t, scale_rad, _STEPS)
    return kernels.model_of_pose(R, t)
