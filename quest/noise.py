"""The noise of the bearings, the last refinement of a motion, and the choice between motions."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import log

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels
from quest.robust.pose_modes import same_mode
from quest.robust.pose_problem import PoseProblem
from quest.robust.samples import RansacReport
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS

Floats = NDArray[np.float64]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
GATE_SIGMAS = 3.0
#: Scale of the kernel by which the covariance of a pose counts its residuals, in standard deviations of the noise.
KERNEL_SIGMAS = 3.0
#: Number of unknowns of a motion.
_UNKNOWNS = 5
#: Smallest and largest deviation of a match, in thresholds: the features of exact data, and a threshold of three
#: deviations. Outliers are a twentieth as dense as a match of unknown scale: within 0.02 to 0.1 the answers on real
#: pairs are the same.
_SCALES, _OUTLIERS = (0.01, 1 / 3), 0.05
#: What a match that only one of two motions explains adds to the logarithm of its likelihood.
OUTLIER_NATS = -log(_OUTLIERS)
#: Steps of the table of the likelihood: four in the smallest deviation.
_TABLE = 400
#: Largest number of other modes of the search that are compared with the best, and of matches that compare them.
_MODES, MOST_COMPARED = 4, 500
#: Stages of the refinement of another mode: the largest Sampson error and the scale of the kernel, in thresholds;
#: largest number of steps of each.
_STAGES, _STEPS = np.array([(2.0, 0.5), (1.0, 0.5)]), 6
#: Scale of the losses beside "mixture" in thresholds, as PoseLib has it; number of their steps; the last
#: step.
_LOSS_SCALE, _LOSS_STEPS, _LOSS_SETTLED_RAD = 0.5, 25, 1e-7
#: Weight of a match by its squared residual, in units of the squared scale, for each of these losses.
LOSSES: dict[str, Callable[[Floats], Floats]] = {
    "least_squares": np.ones_like,
    "truncated": lambda u: (u < 1 / _LOSS_SCALE**2).astype(np.float64),
    "huber": lambda u: 1 / np.sqrt(np.maximum(u, 1)),
    "cauchy": lambda u: 1 / (1 + u),
    "geman_mcclure": lambda u: 1 / (1 + u) ** 2,
}


def best_of_modes(
    problem: PoseProblem, report: RansacReport, inliers: int, rng: np.random.Generator
) -> tuple[Floats, float, list[Floats]]:
    """The refined motion (q_wxyz, t) of the largest likelihood among the modes of a search, its noise, and the others.

    The search compares motions by the threshold, before they are refined; see :mod:`quest.robust.kernels.mixture`.

    * ``inliers``: Number of matches that the best motion of the search explains. A raw model that misses half of them
      is left out.
    """
    near = np.flatnonzero(report.costs[1:] - report.costs[0] < 0.5 * inliers * problem.threshold_rad**2)
    some = problem
    if len(near) > 0 and len(problem) > MOST_COMPARED:
        rows = rng.permutation(len(problem))[:MOST_COMPARED]
        some = PoseProblem(problem.m[rows], problem.n[rows], problem.threshold_rad, problem.loss)
    models = [report.models[0]]
    for k in near[:_MODES].tolist():
        model = report.models[1 + k]
        if 1 + k >= report.refined:
            model = _polished(some, model)
        # Most raw models lead to the optimum that is known.
        if not any(same_mode(model, other) for other in models):
            models.append(model)
    if len(models) == 1:
        return *refine_with_noise(problem, models[0]), []
    refined = [refine_with_noise(some, model) for model in models]
    best = int(np.argmax([log_likelihood(some, model) for model, _ in refined]))
    others = [model for k, (model, _) in enumerate(refined) if k != best]
    model, noise_rad = refined[best] if some is problem else refine_with_noise(problem, refined[best][0])
    return model, noise_rad, others


def log_likelihood(problem: PoseProblem, model: Floats) -> float:
    """Logarithm of the likelihood of a motion (q_wxyz, t) without a scale, less that of outliers alone."""
    return kernels.log_likelihood(problem.m, problem.n, model, problem.threshold_rad, _tables()[0])


def likelihoods(residuals: Floats) -> tuple[Floats, Floats]:
    """Logarithm of the likelihood of matches of unknown scale, less that of an outlier, and their weights.

    The weights are those of re-weighted least squares, which maximizes the likelihood: its derivative by half of the
    squared residual, with the other sign.

    Shapes: ``residuals`` (N,), returns (N,), returns (N,).

    * ``residuals``: In thresholds, of any sign; one or more is an outlier.
    """
    places, (logarithms, weights) = np.abs(residuals), _tables()
    known = np.linspace(0, 1, _TABLE + 1)
    return np.interp(places, known, logarithms, right=0.0), np.interp(places, known, weights, right=0.0)


@cache
def _tables() -> tuple[Floats, Floats]:
    """What :func:`likelihoods` gives for residuals from zero to the threshold in equal steps."""
    residuals = np.linspace(0, 1, _TABLE + 1)[:, None]
    scales = np.geomspace(*_SCALES, 16)
    densities = np.exp(-0.5 * (residuals / scales) ** 2) / scales
    both = np.mean(densities, axis=1) + _OUTLIERS
    return np.asarray(np.log(both / _OUTLIERS)), np.mean(densities / scales**2, axis=1) / both


def refine_with_noise(problem: PoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine a motion (q_wxyz, t) with the noise that its residuals show; return the motion and that noise.

    The refinement is that of :mod:`quest.robust.kernels.mixture`, or that of another loss. The noise is the standard
    deviation of a bearing, from the median absolute residual; at least a thousandth of the threshold. Matches of
    untypical depth do not take part in it: an outlier that fits a motion by chance lies anywhere on its epipolar line,
    while with little parallax the points of the scene lie within a few pixels of their lines.

    P. J. Rousseeuw and A. M. Leroy, "Robust Regression and Outlier Detection", 1987, section 5.1: the factor for small
    samples.
    """
    threshold_rad, mixture = problem.threshold_rad, problem.loss == "mixture"
    if not mixture:
        model = _refined_with_loss(problem, model)
    least_rad = 1e-3 * threshold_rad
    model, count, median_rad = kernels.refine_with_noise(
        problem.m, problem.n, model, mixture, threshold_rad, least_rad, RATIO_MADS, LEAST_SINE2
    )
    if count < _UNKNOWNS + 1:
        return model, threshold_rad / GATE_SIGMAS
    # 1.4826 times the median absolute deviation is the deviation of a Gaussian. The lower bound keeps the gates of
    # exact data open.
    return model, max(1.4826 * _few_matches(count) * median_rad, least_rad)


def _refined_with_loss(problem: PoseProblem, model: Floats) -> Floats:
    """Refine a motion (q_wxyz, t) by re-weighted least squares over the matches within twice the threshold."""
    from quest.robust.kernels import refinement

    m, n, threshold_rad, weight_of = problem.m, problem.n, problem.threshold_rad, LOSSES[problem.loss]
    use = problem.explained(model, 2 * threshold_rad)
    if use.sum() <= _UNKNOWNS:
        return model
    R, t = kernels.rotation_of_model(model), model[4:].copy()
    rays, rows = kernels.rays_by_row(m[use], n[use]), np.empty((7, int(use.sum())))
    A, g, damped, step = np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5)
    for _ in range(_LOSS_STEPS):
        refinement.derivatives(rays, R, t, 1.0, rows)
        # The sums multiply by the square of the last row.
        rows[6] = np.sqrt(weight_of((rows[5] / (_LOSS_SCALE * threshold_rad)) ** 2))
        refinement.sums_of(rows, A, g)
        if not refinement.damped_step(A, g, 1e-9, damped, step):
            break
        refinement.move(R.copy(), t.copy(), step, R, t)
        if np.abs(step).max() < _LOSS_SETTLED_RAD:
            break
    return kernels.model_of_pose(R, t)


def _few_matches(count: int) -> float:
    """The factor of Rousseeuw and Leroy for small samples: the motion has adapted to few matches."""
    return 1 + _UNKNOWNS / max(count - _UNKNOWNS, 1)


def _polished(problem: PoseProblem, model: Floats) -> Floats:
    """A raw motion (q_wxyz, t) of a sample, refined on the matches within twice the threshold and within it.

    The motion stays as it is where fewer than six matches are inliers.
    """
    stages = problem.threshold_rad * _STAGES
    return kernels.climb(problem.m, problem.n, model, problem.threshold_rad, stages, len(problem), _STEPS)[0]
