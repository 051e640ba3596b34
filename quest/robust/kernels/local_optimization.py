"""Local optimization of the search: refinement of a model on the matches near it, and refits to small subsets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import copy_pose, copy_row, model_of_pose, rotation_of_model
from quest.jit import compiled, part
from quest.robust.kernels.refinement import refine
from quest.robust.kernels.scoring import match_residual, rays_by_row, score_or_refute

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Fewer matches do not determine a motion: it has five unknowns.
_LEAST_NEAR = 6


@part
def draw_subset(uniform: Floats, count: int, subset: Ints) -> None:
    """Draw a subset of ``range(count)``, each with the same probability, by Floyd's method.

    Shapes: ``uniform`` (K,), ``subset`` (S,).
    """
    size = len(subset)
    for k in range(size):
        end = count - size + k
        number = min(int(uniform[k] * (end + 1)), end)
        for j in range(k):
            # The end of the range replaces a number sampled before: no earlier range reached it.
            if subset[j] == number:
                number = end
                break
        subset[k] = number


@compiled
def draw_subsets(uniform: Floats, count: int) -> Ints:
    """Draw subsets of ``range(count)``.

    Shapes: ``uniform`` (S, K), returns (S, K).
    """
    samples = np.empty(uniform.shape, np.int64)
    for i in range(len(samples)):
        draw_subset(uniform[i], count, samples[i])
    return samples


@compiled
def climb(
    m: Floats, n: Floats, model: Floats, threshold_rad: float, stages: Floats, most: int, iterations: int
) -> tuple[Floats, float, int]:
    """Refine a model in stages, each on the matches near it, and score it on all matches.

    Shapes: ``m, n`` (N, 3), ``model`` (7,), ``stages`` (S, 2), returns ``model`` (7,).

    * ``m, n``: Unit bearings in camera 1 and camera 2, in random order where there are more than ``most``.
    * ``stages``: For each stage the largest Sampson error of a match that is near, and the scale of the loss.
    * Returns ``cost``: Truncated sum of squared Sampson errors, rad^2, of all matches.
    """
    R, t, near = rotation_of_model(model), model[4:].copy(), np.empty(len(m), np.bool_)
    for k in range(len(stages)):
        gate2, count = stages[k, 0] * stages[k, 0], 0
        for i in range(len(m)):
            near[i] = False
            if count < most:
                r2, behind = match_residual(m, i, n, i, R, t, 2 * threshold_rad * threshold_rad)
                if r2 < gate2 and not behind:
                    near[i] = True
                    count += 1
        if count < _LEAST_NEAR:
            break
        refine(m, n, near, R, t, stages[k, 1], iterations)
    cost, inliers, _ = score_or_refute(rays_by_row(m, n), R, t, threshold_rad, np.inf, 0.0, 0.0)
    return model_of_pose(R, t), cost, inliers


@compiled
def refit(
    m: Floats, n: Floats, model: Floats, threshold_rad: float, uniform: Floats, most: int, iterations: int, places: int
) -> Floats:
    """Fit a pose to random subsets of its inliers, and keep the fits of least cost.

    Shapes: ``m, n`` (N, 3), ``model`` (7,), ``uniform`` (S, K), returns (P, 7).

    * ``m, n``: Unit bearings in camera 1 and camera 2, in random order where there are more than ``most``.
    * ``uniform``: Uniform random numbers from 0 to below 1: S subsets of K inliers.
    * ``most``: Number of matches, from the first, by which the fits are made and compared.
    * ``places``: Number of fits, S or less.
    * Returns: The fits by cost; none where there are no more than K inliers.
    """
    limit, size, total = threshold_rad * threshold_rad, uniform.shape[1], min(most, len(m))
    R, t, fits = rotation_of_model(model), model[4:], np.empty((places, 7))
    inliers, count = np.empty(total, np.int64), 0
    for i in range(total):
        r2, behind = match_residual(m, i, n, i, R, t, 2 * limit)
        if r2 < limit and not behind:
            inliers[count] = i
            count += 1
    inliers = inliers[:count]
    if count <= size:
        return fits[:0]
    rays = rays_by_row(m[:total], n[:total])
    costs, subset, every = np.empty(places), np.empty(size, np.int64), np.empty(size, np.bool_)
    some_m, some_n, R_fit, t_fit = np.empty((size, 3)), np.empty((size, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(places):
        costs[k] = np.inf
    for i in range(len(uniform)):
        draw_subset(uniform[i], len(inliers), subset)
        for j in range(size):
            every[j] = True
            for k in range(3):
                some_m[j, k], some_n[j, k] = m[inliers[subset[j]], k], n[inliers[subset[j]], k]
        copy_pose(R, t, R_fit, t_fit)
        refine(some_m, some_n, every, R_fit, t_fit, 2 * threshold_rad, iterations)
        cost, _, _ = score_or_refute(rays, R_fit, t_fit, threshold_rad, costs[places - 1], 0.0, 0.0)
        if not cost < costs[places - 1]:
            continue
        at = places - 1
        while at > 0 and cost < costs[at - 1]:
            copy_row(fits[at - 1], fits[at])
            costs[at] = costs[at - 1]
            at -= 1
        copy_row(model_of_pose(R_fit, t_fit), fits[at])
        costs[at] = cost
    return fits
