"""The pool of a search: score the solutions of samples, and keep the best of each mode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import copy_pose
from quest.jit import compiled, part
from quest.robust.kernels.scoring import rays_by_row, score_or_refute

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: R (P, 3, 3) and t (P, 3) of the best models of P modes, their costs (P,), in this order and infinite where empty, and
#: numbers of inliers (P,); then the share of matches that a model explains, summed over all models so far, and the
#: number of models (2,). Functions change it in place.
Pool = tuple[Floats, Floats, Floats, Ints, Floats]

#: Two models of a pool nearer than this (radians, rotation plus direction) are one mode: models from five noisy
#: matches scatter by several degrees about their mode.
SAME_MODE_RAD = 0.26


@compiled
def mode_distance(R1: Floats, t1: Floats, R2: Floats, t2: Floats) -> float:
    """Angle between two rotations plus angle between two directions.

    Shapes: ``R1, t1`` (3, 3), ``R2, t2`` (3, 3).
    """
    trace, cosine = 0.0, t1[0] * t2[0] + t1[1] * t2[1] + t1[2] * t2[2]
    for i in range(3):
        trace += R1[i, 0] * R2[i, 0] + R1[i, 1] * R2[i, 1] + R1[i, 2] * R2[i, 2]
    between_rotations: float = np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1))))
    between_directions: float = np.arccos(min(1.0, max(-1.0, cosine)))
    return between_rotations + between_directions


@part
def enter_if_better(rays: Floats, R: Floats, t: Floats, threshold_rad: float, pool: Pool) -> None:
    """Score a model, and enter it into the pool where it is better than the last of the pool.

    Shapes: ``rays`` (6, N), ``R, t`` (3, 3).

    * ``rays``: Unit bearings in random order, see :func:`quest.robust.kernels.scoring.rays_by_row`.
    """
    _, _, costs, counts, chance = pool
    # A model from a few noisy matches explains at least half of the matches that it explains after refinement. Nearly
    # all models so far were bad, so the mean share over them is the share of a bad model.
    good = 0.5 * counts[0] / rays.shape[1]
    cost, inliers, share = score_or_refute(
        rays, R, t, threshold_rad, costs[len(costs) - 1], good, chance[0] / max(chance[1], 1.0)
    )
    chance[0] += share
    chance[1] += 1
    if cost < costs[len(costs) - 1]:
        _enter_pool(R, t, cost, inliers, pool)


@compiled
def try_poses(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, pool: Pool) -> None:
    """Enter poses into the pool, with either sign of the translation.

    Shapes: ``m, n`` (N, 3), ``R`` (K, 3, 3), ``t`` (K, 3).
    """
    rays = rays_by_row(m, n)
    for k in range(len(R)):
        enter_if_better(rays, R[k], t[k], threshold_rad, pool)
        enter_if_better(rays, R[k], -t[k], threshold_rad, pool)


@part
def _enter_pool(R: Floats, t: Floats, cost: float, inliers: int, pool: Pool) -> None:
    """Enter a model into the ordered pool, unless a better model of its mode is there.

    The model takes the place of all members of its mode, not only of the nearest: a new model between two members of
    the pool makes one mode of both. Where there is no such member, the model takes the place of the last one.
    """
    pool_R, pool_t, costs, counts, _ = pool
    size, kept = len(costs), 0
    for j in range(size):
        if not costs[j] < np.inf:
            break
        if mode_distance(R, t, pool_R[j], pool_t[j]) < SAME_MODE_RAD:
            # The members are ordered by cost, so no member of this mode has been removed yet.
            if not cost < costs[j]:
                return
            continue
        if kept < j:
            copy_pose(pool_R[j], pool_t[j], pool_R[kept], pool_t[kept])
            costs[kept], counts[kept] = costs[j], counts[j]
        kept += 1
    for j in range(kept, size):
        costs[j], counts[j] = np.inf, 0
    at = min(kept, size - 1)
    while at > 0 and cost < costs[at - 1]:
        copy_pose(pool_R[at - 1], pool_t[at - 1], pool_R[at], pool_t[at])
        costs[at], counts[at] = costs[at - 1], counts[at - 1]
        at -= 1
    copy_pose(R, t, pool_R[at], pool_t[at])
    costs[at], counts[at] = cost, inliers
