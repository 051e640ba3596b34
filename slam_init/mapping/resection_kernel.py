"""The compiled refinement of an absolute pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.algebra import copy_pose, solve_in_place, turn
from quest.jit import compiler_of
from slam_init.types.arrays import Floats

compiled = compiler_of(Path(__file__).parent)
part = compiler_of(Path(__file__).parent, part=True)

#: Damping at the start, its factor after each step that fails or succeeds, and its least value.
_DAMPING, _RAISE, _LEAST_DAMPING = 1e-4, 10.0, 1e-9
#: The steps end where one lowers the cost by less than this share.
_TOLERANCE = 1e-9


@compiled
def refine_absolute_pose(R: Floats, t: Floats, points: Floats, bearings: Floats, scale_rad: float, steps: int) -> None:
    """Refine a pose by Gauss-Newton steps on the angles between rays and points, with a Geman-McClure kernel.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``points`` (N, 3), ``bearings`` (N, 3).
    """
    scale2 = scale_rad * scale_rad
    A, g = np.zeros((6, 6)), np.zeros(6)
    cost, damping = _accumulate(R, t, points, bearings, scale2, A, g), _DAMPING
    tried_R, tried_t = np.empty((3, 3)), np.empty(3)
    tried_A, tried_g = np.zeros((6, 6)), np.zeros(6)
    for _ in range(steps):
        for i in range(6):  # not by slices: their assignment takes the compiler three seconds
            for j in range(6):
                tried_A[i, j] = A[i, j]
            tried_A[i, i] += damping * A[i, i] + 1e-300
            tried_g[i] = -g[i]
        if not solve_in_place(tried_A, tried_g):
            return  # the points do not determine the pose: keep the current one
        copy_pose(R, t, tried_R, tried_t)
        turn(tried_R, tried_g[0], tried_g[1], tried_g[2])
        # The pose is moved from the left: its translation turns too.
        w0, w1, w2 = tried_g[0], tried_g[1], tried_g[2]
        turned = np.zeros((3, 3))
        turned[0, 0], turned[1, 0], turned[2, 0] = t[0], t[1], t[2]
        turn(turned, w0, w1, w2)
        for i in range(3):
            tried_t[i] = turned[i, 0] + tried_g[3 + i]
        lower = _accumulate(tried_R, tried_t, points, bearings, scale2, tried_A, tried_g)
        if lower <= cost:
            gain, cost = cost - lower, lower
            copy_pose(tried_R, tried_t, R, t)
            A, tried_A = tried_A, A
            g, tried_g = tried_g, g
            damping = max(damping / _RAISE, _LEAST_DAMPING)
            if gain <= _TOLERANCE * cost:
                return
        else:
            damping *= _RAISE


@part
def _accumulate(R: Floats, t: Floats, points: Floats, bearings: Floats, scale2: float, A: Floats, g: Floats) -> float:
    """Robust cost, and the normal equations (A, g) of a step (w, tau) from the left: ``dX = w x X + tau``."""
    A[:], g[:] = 0.0, 0.0
    cost = 0.0
    X, ray, r = np.empty(3), np.empty(3), np.empty(3)
    J = np.empty((3, 6))
    for n in range(len(points)):
        for i in range(3):
            X[i] = R[i, 0] * points[n, 0] + R[i, 1] * points[n, 1] + R[i, 2] * points[n, 2] + t[i]
        distance = max(np.sqrt(X[0] * X[0] + X[1] * X[1] + X[2] * X[2]), 1e-12)
        r2 = 0.0
        for i in range(3):
            ray[i] = X[i] / distance
            r[i] = ray[i] - bearings[n, i]
            r2 += r[i] * r[i]
        cost += r2 / (scale2 + r2)
        weight = 1.0 / (1.0 + r2 / scale2) ** 2
        # d ray / dX = (I - ray ray^T) / distance
        for i in range(3):
            p0, p1, p2 = (-ray[i] * ray[0] / distance, -ray[i] * ray[1] / distance, -ray[i] * ray[2] / distance)
            if i == 0:
                p0 += 1.0 / distance
            elif i == 1:
                p1 += 1.0 / distance
            else:
                p2 += 1.0 / distance
            J[i, 0] = p2 * X[1] - p1 * X[2]
            J[i, 1] = p0 * X[2] - p2 * X[0]
            J[i, 2] = p1 * X[0] - p0 * X[1]
            J[i, 3], J[i, 4], J[i, 5] = p0, p1, p2
        for i in range(6):
            g[i] += weight * (J[0, i] * r[0] + J[1, i] * r[1] + J[2, i] * r[2])
            for j in range(i + 1):
                A[i, j] += weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j] + J[2, i] * J[2, j])
    for i in range(6):
        for j in range(i):
            A[j, i] = A[i, j]
    return cost
