"""Refinement of a pose, and of a rotation alone, by weighted least squares steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.kernels.compiler import compiled
from quest.robust.kernels.small_algebra import copy_pose, rotation_of_model, shift, solve_in_place, tangents, turn

__all__ = ["refine", "refine_model", "refine_rotation"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A smaller step changes nothing that the data can show: a thousandth of the noise of the best features.
_SETTLED_RAD = 1e-8


@compiled
def _normal_equations(
    m: Floats, n: Floats, use: Bools, R: Floats, t: Floats, scale2: float, A: Floats, g: Floats
) -> float:
    """Write the weighted normal equations A (5, 5), g (5,) of the Sampson errors and return the robust cost.

    The derivatives are those of :mod:`quest.geometry.refine`.
    """
    x, y, z, u, v, w = tangents(t)
    for j in range(5):
        g[j] = 0.0
        for k in range(5):
            A[j, k] = 0.0
    J = np.empty(5)
    cost = 0.0
    for i in range(len(m)):
        if not use[i]:
            continue
        a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
        a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
        a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
        n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
        p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n0 * t[0] + n1 * t[1] + n2 * t[2]
        cosine = a0 * n0 + a1 * n1 + a2 * n2
        c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
        e = c0 * t[0] + c1 * t[1] + c2 * t[2]
        D = max(2 - p * p - s * s - 2 * e * e, 1e-12)
        root = np.sqrt(D)
        r = e / root
        # Derivatives by the rotation (J0 to J2), then by the direction (J3, J4).
        along = 1 / root + 2 * e * e / (D * root)
        by_p, by_s = e * p / (D * root), e * s / (D * root)
        J[0] = along * (n0 * p - t[0] * cosine) + by_p * (a1 * t[2] - a2 * t[1])
        J[1] = along * (n1 * p - t[1] * cosine) + by_p * (a2 * t[0] - a0 * t[2])
        J[2] = along * (n2 * p - t[2] * cosine) + by_p * (a0 * t[1] - a1 * t[0])
        J[3] = (
            along * (c0 * x + c1 * y + c2 * z) + by_p * (a0 * x + a1 * y + a2 * z) + by_s * (n0 * x + n1 * y + n2 * z)
        )
        J[4] = (
            along * (c0 * u + c1 * v + c2 * w) + by_p * (a0 * u + a1 * v + a2 * w) + by_s * (n0 * u + n1 * v + n2 * w)
        )
        share = scale2 / (scale2 + r * r)
        cost += r * r / scale2 * share
        weight = share * share
        for j in range(5):
            g[j] += weight * J[j] * r
            for k in range(j, 5):
                A[j, k] += weight * J[j] * J[k]
    for j in range(5):
        for k in range(j):
            A[j, k] = A[k, j]
    return cost


@compiled
def refine(m: Floats, n: Floats, use: Bools, R: Floats, t: Floats, scale_rad: float, iterations: int) -> None:
    """Refine a pose in place, as :func:`quest.geometry.refine.refine_pose`.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    use : (N,) bool
        The matches to refine on.
    R, t : (3, 3) float, (3,) float
        The start; overwritten by the refined pose.
    scale_rad : float
        Scale of the Geman-McClure kernel.
    iterations : int
        Largest number of steps.
    """
    scale2 = scale_rad * scale_rad
    A, g, damped, step = np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5)
    cost, damping = _normal_equations(m, n, use, R, t, scale2, A, g), 1e-4
    R_new, t_new = np.empty((3, 3)), np.empty(3)
    for _ in range(iterations):
        trace = A[0, 0] + A[1, 1] + A[2, 2] + A[3, 3] + A[4, 4]
        if not (trace > 0 and np.isfinite(trace)):
            return
        # Divided by the trace, so that the bound on the pivots is a bound on the condition.
        for j in range(5):
            for k in range(5):
                damped[j, k] = A[j, k] / trace
            damped[j, j] += damping * damped[j, j] + 1e-12
            step[j] = -g[j] / trace
        if not solve_in_place(damped, step):
            return
        longest = 1.0  # a radian: the derivatives are not valid beyond
        for j in range(5):
            longest = max(longest, abs(step[j]))
        for j in range(5):
            step[j] /= longest
        copy_pose(R, t, R_new, t_new)
        x, y, z, u, v, w = tangents(t)
        turn(R_new, step[0], step[1], step[2])
        shift(t_new, step[3], step[4], x, y, z, u, v, w)
        cost_new = _normal_equations(m, n, use, R_new, t_new, scale2, damped, step)
        if cost_new <= cost:
            gain, cost = cost - cost_new, cost_new
            copy_pose(R_new, t_new, R, t)
            A, damped = damped, A
            g, step = step, g
            damping = max(damping * 0.1, 1e-9)
            if gain <= 1e-9 * max(cost, 1e-30):
                return
        else:
            damping *= 10
            if damping > 1e4:
                return


@compiled
def refine_model(m: Floats, n: Floats, use: Bools, model: Floats, scale_rad: float, iterations: int) -> Floats:
    """Refine a pose as :func:`refine`, given and returned in one row.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    use : (N,) bool
        The matches to refine on.
    model : (7,) float
        The start (q_wxyz, t), unit norm each.
    scale_rad : float
        Scale of the Geman-McClure kernel.
    iterations : int
        Largest number of steps.

    Returns
    -------
    (12,) float
        The nine entries of R, row by row, then t.
    """
    R, t, pose = rotation_of_model(model), np.empty(3), np.empty(12)
    for i in range(3):
        t[i] = model[4 + i]
    refine(m, n, use, R, t, scale_rad, iterations)
    for i in range(3):
        pose[9 + i] = t[i]
        for j in range(3):
            pose[3 * i + j] = R[i, j]
    return pose


@compiled
def refine_rotation(m: Floats, n: Floats, R: Floats, scale_rad: float, iterations: int) -> None:
    """Refine a rotation in place, as :func:`quest.geometry.refine.refine_rotation`.

    The weights are the same; a Newton step takes the place of each Kabsch fit.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    R : (3, 3) float
        The start; overwritten by the refined rotation.
    scale_rad : float
        Scale of the Geman-McClure kernel.
    iterations : int
        Largest number of steps.
    """
    scale2 = scale_rad * scale_rad
    A, g = np.empty((3, 3)), np.empty(3)
    for _ in range(iterations):
        total = 0.0
        for j in range(3):
            g[j] = 0.0
            for k in range(3):
                A[j, k] = 0.0
        for i in range(len(m)):
            a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
            a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
            a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
            n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
            d2 = (n0 - a0) ** 2 + (n1 - a1) ** 2 + (n2 - a2) ** 2
            share = scale2 / (scale2 + 0.5 * d2)
            weight = share * share
            total += weight
            # The optimal small turn w: sum of (a . n - (a n^T + n a^T) / 2) w = sum of a x n.
            cosine = a0 * n0 + a1 * n1 + a2 * n2
            A[0, 0] += weight * (cosine - a0 * n0)
            A[1, 1] += weight * (cosine - a1 * n1)
            A[2, 2] += weight * (cosine - a2 * n2)
            A[0, 1] -= 0.5 * weight * (a0 * n1 + a1 * n0)
            A[0, 2] -= 0.5 * weight * (a0 * n2 + a2 * n0)
            A[1, 2] -= 0.5 * weight * (a1 * n2 + a2 * n1)
            g[0] += weight * (a1 * n2 - a2 * n1)
            g[1] += weight * (a2 * n0 - a0 * n2)
            g[2] += weight * (a0 * n1 - a1 * n0)
        if not total > 0:
            return
        for j in range(3):
            g[j] /= total
            for k in range(j, 3):
                A[j, k] /= total
                A[k, j] = A[j, k]
        if not solve_in_place(A, g):
            return
        angle = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
        factor = min(1.0, 1 / max(angle, 1e-300))  # at most one radian a step: a half turn takes four steps
        turn(R, factor * g[0], factor * g[1], factor * g[2])
        if angle < _SETTLED_RAD:
            return
