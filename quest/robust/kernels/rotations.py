"""The rotation that explains most matches by itself: two matches propose one, the others decide."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.jit import compiled
from quest.robust.kernels.local_optimization import draw_subset

Floats = NDArray[np.float64]


@compiled
def _frame(rays: Floats, i: int, j: int, least_rad: float, F: Floats) -> bool:
    """Write the frame (3, 3) of two rays, its axes as columns; False where the rays determine none."""
    a0, a1, a2, b0, b1, b2 = rays[i, 0], rays[i, 1], rays[i, 2], rays[j, 0], rays[j, 1], rays[j, 2]
    x0, x1, x2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    y0, y1, y2 = a0 + b0, a1 + b1, a2 + b2
    width, length = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2), np.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
    if not min(width, length) > least_rad:
        return False
    x0, x1, x2, y0, y1, y2 = x0 / width, x1 / width, x2 / width, y0 / length, y1 / length, y2 / length
    F[0, 0], F[1, 0], F[2, 0], F[0, 1], F[1, 1], F[2, 1] = x0, x1, x2, y0, y1, y2
    F[0, 2], F[1, 2], F[2, 2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    return True


@compiled
def best_rotation(m: Floats, n: Floats, uniform: Floats, threshold_rad: float, least_rad: float, best: Floats) -> bool:
    """The rotation of least truncated cost among those that pairs of matches propose.

    Shapes: ``m, n`` (N, 3), ``uniform`` (S, 2), ``best`` (3, 3).

    * ``least_rad``: Two rays that are nearer to each other, or to opposite directions, determine no rotation.
    """
    pair, R, F1, F2 = np.empty(2, np.int64), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    lowest, limit = np.inf, 4 * threshold_rad * threshold_rad
    for k in range(len(uniform)):
        draw_subset(uniform[k], len(m), pair)
        if not (_frame(m, pair[0], pair[1], least_rad, F1) and _frame(n, pair[0], pair[1], least_rad, F2)):
            continue
        for i in range(3):
            for j in range(3):
                R[i, j] = F2[i, 0] * F1[j, 0] + F2[i, 1] * F1[j, 1] + F2[i, 2] * F1[j, 2]
        R00, R01, R02, R10, R11, R12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
        R20, R21, R22 = R[2, 0], R[2, 1], R[2, 2]
        cost = 0.0
        for i in range(len(m)):
            m0, m1, m2 = m[i, 0], m[i, 1], m[i, 2]
            # |n - R m|^2 / 2 = 1 - n . R m.
            r2 = 1 - (
                n[i, 0] * (R00 * m0 + R01 * m1 + R02 * m2)
                + n[i, 1] * (R10 * m0 + R11 * m1 + R12 * m2)
                + n[i, 2] * (R20 * m0 + R21 * m1 + R22 * m2)
            )
            cost += min(r2, limit)
            if not cost < lowest:
                break
        if cost < lowest:
            lowest = cost
            for i in range(3):
                for j in range(3):
                    best[i, j] = R[i, j]
    return lowest < np.inf
