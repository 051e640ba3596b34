"""Comparison of two motions on the same matches: which alternatives to a pose remain, and whether a plane is one.

Motions are compared by one score, the likelihood of all matches (:mod:`quest.robust.loss`). The difference of two
scores is a sum over matches whose errors are correlated between neighbours: a moving object, one part of the lens or a
repeated texture. So the difference is compared with its scatter over regions of the view.

References
----------
.. [V89] Q. H. Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57, 1989.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from quest.geometry.homography import homography_residuals
from quest.geometry.quaternion import canonical
from quest.noise import GATE_SIGMAS, SAME_FIT_NATS, log_likelihood, log_likelihoods_of
from quest.relative_pose import Hypothesis
from quest.robust import kernels
from quest.robust.loss import OUTLIER_NATS
from quest.robust.plane import PlaneFit
from quest.robust.pose_problem import PoseProblem, distinct_modes
from quest.robust.spatial_blocks import directions_of, scatter_of_sum

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Largest number of alternatives.
_MOST = 3
#: Standard deviations by which a motion has to be less probable, to be dropped: four are exceeded once in 30 000, and
#: an alternative is dropped for good.
_DROPPED_SIGMAS = 4.0
#: Least cosine of a slant, and least noise in thresholds: exact matches have residuals of rounding errors.
_LEAST_COSINE, _LEAST_NOISE = 1e-3, 1e-3
#: The depth variation of all matches may exceed its mean by chance by this number of standard deviations, once in 160
#: planes. Its variance is 2 a match, and 5.4 more since the noise, by which it is divided, comes from a median of as
#: many residuals. Two in a hundred matches may lie off the plane and add 9 each: 25 planes with 15 % outliers left 1.5
#: %.
_VARIATION_SIGMAS, _CHI2_VARIANCE, _OFF_PLANE, _LARGEST_VARIATION = 2.5, 7.4, 0.02, 9.0


def explained_by_plane(problem: PoseProblem, plane: PlaneFit, best: Floats, inliers: int) -> bool:
    """Whether the inliers of the best motion lie on one plane, and one of the plane's motions fits them as well.

    The residuals along the epipolar lines must have the size of the noise in their sum: the depth variation.

    Shapes: ``best`` (7,).
    """
    chance = inliers + _VARIATION_SIGMAS * np.sqrt(_CHI2_VARIANCE * inliers)
    if len(plane.poses) < 2 or plane.depth_variation > chance + _LARGEST_VARIATION * _OFF_PLANE * inliers:
        return False
    return any(not _is_less_probable(problem, pose, best) for pose in plane.poses)


def more_probable_first(problem: PoseProblem, plane: PlaneFit, noise_rad: float) -> list[Floats]:
    """The motions (q_wxyz, t) of a plane by the likelihood of the matches on it, the more probable one first.

    Both motions have the same residuals of the homography. A depth variation adds to those along the epipolar lines of
    the true motion. With A and C the sums of squares along and across the lines, the likelihood under the most probable
    depth variation is ``-N/2 (log A + log C)``, or that of equal variances where A < C, so that an exact plane says
    nothing. A match behind a camera is an outlier.

    A patch of a plane fills a part of the view in proportion to the cosine of its slant, in both views. The measure of
    homographies does not depend on which of its motions makes one: the cosines are the prior.
    """
    d = homography_residuals(plane.H, problem.m, problem.n)
    on = np.sum(d**2, axis=1) < 2 * (GATE_SIGMAS * noise_rad) ** 2
    d, m, n, scores = d[on], problem.m[on], problem.n[on], []
    both, least = float(np.sum(d**2)), len(d) * (_LEAST_NOISE * problem.threshold_rad) ** 2
    for model, normal in zip(plane.poses, plane.normals, strict=True):
        line = model[4:] - (n @ model[4:])[:, None] * n
        along = float(np.sum(np.sum(d * line, axis=1) ** 2 / np.maximum(np.sum(line**2, axis=1), 1e-12)))
        along = max(along, 0.5 * both)
        depth_variation = -0.5 * len(d) * (np.log(along + least) + np.log(max(both - along, 0.0) + least))
        cosines = np.abs([m.mean(axis=0) @ normal, n.mean(axis=0) @ kernels.rotation_of_model(model) @ normal])
        slant = float(np.log(np.maximum(cosines, _LEAST_COSINE)).sum())
        behind = int(np.isinf(problem.residuals(model)[on]).sum())
        scores.append(depth_variation + slant - OUTLIER_NATS * behind)
    return [plane.poses[k] for k in np.argsort(scores)[::-1]]


def equivalent_motions(
    problem: PoseProblem, candidates: Sequence[Floats], best: Floats, gate_rad: float
) -> list[Hypothesis]:
    """The candidates that explain the matches as well as the best motion, the more probable ones first.

    Shapes: ``candidates`` (7,), ``best`` (7,).
    """
    others = distinct_modes([best, *candidates])[1:]
    kept = [model for model in others if not _is_less_probable(problem, model, best)]
    kept.sort(key=lambda model: -log_likelihood(problem, model))
    return [as_hypothesis(model, problem.explained(model, gate_rad)) for model in kept[:_MOST]]


def _is_less_probable(problem: PoseProblem, model: Floats, other: Floats) -> bool:
    """Whether a motion is significantly less probable than another one [V89]_."""
    votes = log_likelihoods_of(problem, other) - log_likelihoods_of(problem, model)
    behind = float(votes.sum())
    # The scatter over regions is at least that over matches, and takes longer to compute.
    if behind <= max(SAME_FIT_NATS, _DROPPED_SIGMAS * float(np.sqrt(np.sum(votes**2)))):
        return False
    differs = votes != 0
    return behind > _DROPPED_SIGMAS * scatter_of_sum(votes[differs], directions_of(problem.m[differs]))


def as_hypothesis(model: Floats, inliers: Bools) -> Hypothesis:
    """The motion of a row as a :class:`quest.Hypothesis`.

    Shapes: ``model`` (7,), ``inliers`` (N,).
    """
    q = canonical(model[:4]) if model[0] <= 0 else model[:4]
    return Hypothesis(q, kernels.rotation_of_model(model), model[4:], inliers)
