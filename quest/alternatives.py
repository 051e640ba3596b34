"""Comparison of two motions on the same matches: which alternatives to a pose remain, and whether a plane is one.

A motion explains the matches as well as another one if two conditions hold:

* No significant number of matches is explained by the other motion only. This compares counts with their fluctuation
  (:func:`decides`).
* Its residuals on the matches that both explain are not larger (:func:`has_larger_residuals`). This compares sums of
  truncated squares with their scatter over regions of the view, so that one moving body or one part of the lens does
  not decide.

The two motions of a plane have the same residuals of the homography. So only the counts are compared between them, and
what orders them is :func:`more_probable_first`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import canonical
from quest.noise import GATE_SIGMAS, OUTLIER_NATS
from quest.relative_pose import Hypothesis
from quest.robust import kernels
from quest.robust.plane import PlaneFit
from quest.robust.pose_modes import same_mode
from quest.robust.pose_problem import PoseProblem
from quest.robust.spatial_blocks import directions_of, scatter_of_sum

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Ratio of residuals along and across the epipolar lines up to which points lie on a plane: relief as large as the
#: noise makes the ratio 1.4. For few matches the bound is four standard deviations of the ratio of two medians,
#: 1.65 / sqrt(N) each.
_FLAT = 1.5
#: The relief of all matches together tells more than its median. It may exceed its mean by chance by this number of
#: standard deviations, once in 160 planes. Its variance is 2 a match, and 5.4 more since the noise, by which it is
#: divided, comes from a median of as many residuals. Two in a hundred matches may lie off the plane and add 9 each.
_RELIEF_SIGMAS, _RELIEF_VARIANCE, _OFF_PLANE, _LARGEST_RELIEF = 2.5, 7.4, 0.02, 9.0
#: How much larger the residuals of a motion must be: in noise variances, and in standard deviations of their sum. Five
#: unknowns lower the cost by chi-square of five degrees of freedom: by 26 once in 10 000, by 15 once in a hundred. A
#: rival is dropped for good, hence the higher level. A plane must be as good as the free motion, hence the lower one.
RIVAL_LEVEL = (26.0, 4.0)
PLANE_LEVEL = (15.0, 2.5)

#: Smallest noise in thresholds, and least cosine of a slant.
_EXACT = 1e-3
#: Standard deviations by which the numbers of matches off a plane have to differ, to count for one of its motions: two
#: are exceeded once in twenty by chance.
_VOTE_SIGMAS = 2.0


def decides(votes_for: int, votes_against: int, total: int, scatter: float | None = None) -> bool:
    """Whether the numbers of matches that only one of two hypotheses explains decide between the two.

    Under the null hypothesis that neither is better, each vote is a fair coin, and the difference has the standard
    deviation sqrt(for + against). Four of these deviations are exceeded once in 30 000. Votes that come from one small
    moving object or from a repeated texture are not independent; ``scatter`` is then the right deviation. Twelve votes
    and 3 % of all matches are required besides: fewer votes may lie in several regions and still come from one repeated
    texture.

    * ``scatter``: Standard deviation of the difference, see :func:`quest.robust.spatial_blocks.scatter_of_sum`; by
      default that of independent votes.
    """
    difference = votes_for - votes_against
    deviation = float(np.sqrt(votes_for + votes_against)) if scatter is None else scatter
    return bool(difference >= max(12.0, 0.03 * total, 4.0 * deviation))


def has_larger_residuals(
    problem: PoseProblem, model: Floats, other: Floats, gate_rad: float, noise_rad: float, level: tuple[float, float]
) -> bool:
    """Whether a motion leaves significantly larger residuals than another motion.

    The scatter is that of the sum of differences (Vuong 1989), over matches or over regions of the view, so that no
    handful of matches with a common error decides.

    Q. H. Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57, 1989.

    Shapes: ``model, other`` (7,), ``level`` (float, float).
    """
    least, deviations = level
    costs = [np.minimum(problem.residuals(one), gate_rad**2) for one in (model, other)]
    difference = (costs[0] - costs[1]) / noise_rad**2
    larger = float(difference.sum())
    # The scatter over regions is at least that over matches, and takes longer to compute.
    if larger <= max(least, deviations * float(np.sqrt(np.sum(difference**2)))):
        return False
    differs = difference != 0
    return larger > deviations * scatter_of_sum(difference[differs], directions_of(problem.m[differs]))


def explained_by_plane(
    problem: PoseProblem, plane: PlaneFit, best: Floats, inliers: int, gate_rad: float, noise_rad: float
) -> bool:
    """Whether the inliers of the best motion lie on one plane, and one of the plane's motions fits them as well.

    The gate of the plane, 3 sqrt(2) deviations, rejects one match in 8000. Two in a hundred are allowed off the plane,
    for errors that are not Gaussian: 25 planes with 15 % outliers left 1.5 % at most. Points with little parallax pass
    the gate as well, so the residuals along the epipolar lines must have the size of the noise: in the median, and in
    their sum, which tells a relief among few matches.

    Shapes: ``best`` (7,).
    """
    chance = inliers + _RELIEF_SIGMAS * np.sqrt(_RELIEF_VARIANCE * inliers)
    return bool(
        len(plane.poses) == 2
        and plane.relief <= chance + _LARGEST_RELIEF * _OFF_PLANE * inliers
        and not decides(plane.off, int(_OFF_PLANE * inliers), inliers)
        and plane.along_rad < max(_FLAT, 1 + 6.6 / np.sqrt(plane.on)) * noise_rad
        and not all(has_larger_residuals(problem, pose, best, gate_rad, noise_rad, PLANE_LEVEL) for pose in plane.poses)
    )


def more_probable_first(problem: PoseProblem, plane: PlaneFit, gate_rad: float, noise_rad: float) -> list[Floats]:
    """The two motions (q_wxyz, t) of a plane, the more probable one first.

    The logarithm of the probability of each has four parts:

    * A match on the plane that lies behind a camera is an outlier of this motion.
    * Other matches are explained by chance, so that they count where their number is significant.
    * A relief adds to the residuals along the epipolar lines of the true motion. Its size is that of maximum
      likelihood, so that an exact plane says nothing: with A and C the sums of squares along and across the lines, the
      likelihood is ``-N/2 (log A + log C)``, or that of equal variances where A < C.
    * A patch of a plane fills a part of the view in proportion to the cosine of its slant, in both views. The measure
      of homographies does not depend on which of the two motions makes one.
    """
    x = problem.m @ plane.H.T
    d = problem.n - x / np.linalg.norm(x, axis=1, keepdims=True)
    on = np.sum(d**2, axis=1) < 2 * (GATE_SIGMAS * noise_rad) ** 2
    d, m, n = d[on], problem.m[on], problem.n[on]
    # Exact matches have residuals of rounding errors, which say nothing.
    both, least = float(np.sum(d**2)), len(d) * (_EXACT * problem.threshold_rad) ** 2
    scores, others = [], []
    for model, normal in zip(plane.poses, plane.normals, strict=True):
        explained = problem.explained(model, gate_rad)
        s = n @ model[4:]
        # The length of the part of t orthogonal to n.
        sine = np.sqrt(np.maximum(1 - s**2, 1e-12))
        along = float(np.sum((((d @ model[4:]) - s * np.sum(d * n, axis=1)) / sine) ** 2))
        along = max(along, 0.5 * both)
        relief = -0.5 * len(d) * (np.log(along + least) + np.log(max(both - along, 0.0) + least))
        cosines = abs(np.mean(m, axis=0) @ normal), abs(np.mean(n, axis=0) @ kernels.rotation_of_model(model) @ normal)
        slant = float(np.sum(np.log(np.maximum(cosines, _EXACT))))
        scores.append(OUTLIER_NATS * int(explained[on].sum()) + relief + slant)
        others.append(int(explained[~on].sum()))
    if abs(others[0] - others[1]) > _VOTE_SIGMAS * np.sqrt(sum(others)):
        scores = [score + OUTLIER_NATS * count for score, count in zip(scores, others, strict=True)]
    return plane.poses if scores[0] >= scores[1] else plane.poses[::-1]


def equivalent_motions(
    problem: PoseProblem,
    candidates: Sequence[Floats],
    best: Floats,
    inliers: Bools,
    gate_rad: float,
    noise_rad: float | None,
) -> list[Hypothesis]:
    """The candidates that explain the matches as well as the best motion.

    Shapes: ``candidates`` (7,), ``best`` (7,), ``inliers`` (N,).

    * ``noise_rad``: Standard deviation of a bearing; None for the motions of a plane, whose residuals are not compared.
    """
    alternatives: list[Hypothesis] = []
    where = directions_of(problem.m)
    for model in candidates:
        known = [best, *(np.concatenate([h.q_wxyz, h.t]) for h in alternatives)]
        if any(same_mode(model, other) for other in known):
            continue
        explained = problem.explained(model, gate_rad)
        if _has_more_inliers(inliers, explained, where):
            continue
        if noise_rad is not None and has_larger_residuals(problem, model, best, gate_rad, noise_rad, RIVAL_LEVEL):
            continue
        alternatives.append(as_hypothesis(model, explained))
    return sorted(alternatives, key=lambda h: -int(h.inliers.sum()))


def _has_more_inliers(inliers: Bools, explained: Bools, where: Floats) -> bool:
    """Whether significantly more matches at given places (N, 2) are inliers than are explained by another motion."""
    for_best, against = inliers & ~explained, explained & ~inliers
    counts = int(for_best.sum()), int(against.sum()), int(inliers.sum())
    # Scatter raises the bound, so that it is computed only where independent votes decide.
    if not decides(*counts):
        return False
    # The regions divide the part of the view that either motion explains: a poster that fills a part of the view has as
    # many regions as a wall that fills all of it.
    either = inliers | explained
    return decides(*counts, scatter_of_sum(for_best[either].astype(float) - against[either], where[either]))


def as_hypothesis(model: Floats, inliers: Bools) -> Hypothesis:
    """The motion of a row as a :class:`quest.Hypothesis`.

    Shapes: ``model`` (7,), ``inliers`` (N,).
    """
    q = canonical(model[:4]) if model[0] <= 0 else model[:4]
    return Hypothesis(q, kernels.rotation_of_model(model), model[4:], inliers)
