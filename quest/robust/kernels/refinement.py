"""Refinement of a pose, and of a rotation alone, by weighted least squares steps.

The likelihood and the weights of a pose are those of :mod:`quest.robust.loss`. A rotation has the
weights of Geman and McClure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import copy_pose, rotated, shift, solve_in_place, tangents, turn
from quest.jit import compiled, part
from quest.robust.loss import OUTLIERS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A smaller step changes nothing that the data can show: a thousandth of the noise of the best features.
_SETTLED_RAD = 1e-8
#: A step that raises the logarithm of the likelihood by less is the last one: a hundredth of a standard deviation is
#: half of that.
_SETTLED_GAIN = 1e-4


@part
def normal_equations(rays: Floats, R: Floats, t: Floats, scale2: float, rows: Floats, A: Floats, g: Floats) -> float:
    """Write the normal equations of the Sampson errors; return the cost, the sum of L with the other sign.

    Shapes: ``rays`` (6, N), ``R, t`` (3, 3), ``rows`` (7, N), ``A, g`` (5, 5).
    """
    derivatives(rays, R, t, scale2, rows)
    sums_of(rows, A, g)
    # A product of eight is far from the smallest number, and one logarithm takes the place of eight.
    cost, product = 0.0, 1.0
    for i in range(rows.shape[1]):
        product *= 1 + 1 / (OUTLIERS * (1 + rows[5, i] * rows[5, i] / scale2))
        if i % 8 == 7:
            cost -= np.log(product)
            product = 1.0
    rest: float = np.log(product)
    return cost - rest


@compiled
def derivatives(rays: Floats, R: Floats, t: Floats, scale2: float, rows: Floats) -> None:
    """Write the Sampson errors r and their derivatives.

    With a = R m, e = n . (t x a), p = t . a and s = t . n the Sampson error is ::

        r = e / sqrt(2 - p^2 - s^2 - 2 e^2)

    The denominator is the norm of the gradient of e with respect to both unit bearings, each moved on its sphere. r is
    in radians and has the standard deviation of the noise of one bearing. With R perturbed to exp(w) R and t to
    t + B b, B a basis of the plane orthogonal to t, the derivatives follow from ::

        de = w . (a x (n x t)) + (a x n) . B b,    dp = w . (a x t) + a . B b,    ds = n . B b.

    Shapes: ``rays`` (6, N), ``R, t`` (3, 3), ``rows`` (7, N).

    * ``rays``: Unit bearings: three rows of camera 1 and three rows of camera 2.
    * ``rows``: Overwritten: the derivatives by the rotation (0 to 2) and by the direction (3, 4), the error, and its
      weight.
    """
    x, y, z, u, v, w = tangents(t)
    R00, R01, R02, R10, R11, R12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    R20, R21, R22, t0, t1, t2 = R[2, 0], R[2, 1], R[2, 2], t[0], t[1], t[2]
    count = rays.shape[1]
    # This loop has no sum, so that the compiler treats several matches at once.
    for i in range(count):
        m0, m1, m2, n0, n1, n2 = rays[0, i], rays[1, i], rays[2, i], rays[3, i], rays[4, i], rays[5, i]
        a0, a1, a2 = R00 * m0 + R01 * m1 + R02 * m2, R10 * m0 + R11 * m1 + R12 * m2, R20 * m0 + R21 * m1 + R22 * m2
        p, s = a0 * t0 + a1 * t1 + a2 * t2, n0 * t0 + n1 * t1 + n2 * t2
        cosine = a0 * n0 + a1 * n1 + a2 * n2
        c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
        e = c0 * t0 + c1 * t1 + c2 * t2
        D = 2 - p * p - s * s - 2 * e * e
        inverse = 1 / np.sqrt(D if D > 1e-12 else 1e-12)
        r = e * inverse
        slope = r * inverse
        along, by_p, by_s = inverse + 2 * e * slope * inverse, slope * p * inverse, slope * s * inverse
        rows[0, i] = along * (n0 * p - t0 * cosine) + by_p * (a1 * t2 - a2 * t1)
        rows[1, i] = along * (n1 * p - t1 * cosine) + by_p * (a2 * t0 - a0 * t2)
        rows[2, i] = along * (n2 * p - t2 * cosine) + by_p * (a0 * t1 - a1 * t0)
        d0, d1 = along * c0 + by_p * a0 + by_s * n0, along * c1 + by_p * a1 + by_s * n1
        d2 = along * c2 + by_p * a2 + by_s * n2
        rows[3, i], rows[4, i] = d0 * x + d1 * y + d2 * z, d0 * u + d1 * v + d2 * w
        share = scale2 / (scale2 + r * r)
        rows[5, i], rows[6, i] = r, (1 + OUTLIERS) * share * share / (share + OUTLIERS)


@part
def sums_of(rows: Floats, A: Floats, g: Floats) -> None:
    """Write the weighted sums J^T J and J^T r over the rows of :func:`derivatives`.

    Shapes: ``rows`` (7, N), ``A, g`` (5, 5).
    """
    count = rows.shape[1]
    A00 = A01 = A02 = A03 = A04 = A11 = A12 = A13 = A14 = A22 = A23 = A24 = A33 = A34 = A44 = 0.0
    g0 = g1 = g2 = g3 = g4 = 0.0
    # Sums in local variables stay in registers; sums in A and g do not.
    for i in range(count):
        J0, J1, J2, J3, J4 = rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i]
        r, weight = rows[5, i], rows[6, i]
        w0, w1, w2, w3, w4 = weight * J0, weight * J1, weight * J2, weight * J3, weight * J4
        g0, g1, g2, g3, g4 = g0 + w0 * r, g1 + w1 * r, g2 + w2 * r, g3 + w3 * r, g4 + w4 * r
        A00, A01, A02, A03, A04 = A00 + w0 * J0, A01 + w0 * J1, A02 + w0 * J2, A03 + w0 * J3, A04 + w0 * J4
        A11, A12, A13, A14 = A11 + w1 * J1, A12 + w1 * J2, A13 + w1 * J3, A14 + w1 * J4
        A22, A23, A24, A33, A34, A44 = (
            A22 + w2 * J2, A23 + w2 * J3, A24 + w2 * J4, A33 + w3 * J3, A34 + w3 * J4, A44 + w4 * J4,
        )  # fmt: skip
    g[0], g[1], g[2], g[3], g[4] = g0, g1, g2, g3, g4
    A[0, 0], A[0, 1], A[0, 2], A[0, 3], A[0, 4] = A00, A01, A02, A03, A04
    A[1, 1], A[1, 2], A[1, 3], A[1, 4], A[2, 2], A[2, 3], A[2, 4] = A11, A12, A13, A14, A22, A23, A24
    A[3, 3], A[3, 4], A[4, 4] = A33, A34, A44
    for j in range(5):
        for k in range(j):
            A[j, k] = A[k, j]


@part
def damped_step(A: Floats, g: Floats, damping: float, damped: Floats, step: Floats) -> bool:
    """Write the damped step of least squares, of at most a radian; false where there is none. ``damped`` is scratch.

    Shapes: ``A, damped`` (5, 5), ``g, step`` (5,).
    """
    trace = A[0, 0] + A[1, 1] + A[2, 2] + A[3, 3] + A[4, 4]
    if not (trace > 0 and np.isfinite(trace)):
        return False
    # Divided by the trace, so that the bound on the pivots is a bound on the condition.
    for j in range(5):
        for k in range(5):
            damped[j, k] = A[j, k] / trace
        damped[j, j] += damping * damped[j, j] + 1e-12
        step[j] = -g[j] / trace
    if not solve_in_place(damped, step):
        return False
    longest = 1.0  # a radian: the derivatives are not valid beyond
    for j in range(5):
        longest = max(longest, abs(step[j]))
    for j in range(5):
        step[j] /= longest
    return True


@compiled
def refine(m: Floats, n: Floats, use: Bools, R: Floats, t: Floats, scale_rad: float, iterations: int) -> None:
    """Refine a pose in place on the matches to ``use``, by damped steps.

    Shapes: ``m, n`` (N, 3), ``use`` (N,), ``R, t`` (3, 3).
    """
    count = at = 0
    for i in range(len(m)):
        count += use[i]
    rays, rows = np.empty((6, count)), np.empty((7, count))
    for i in range(len(m)):
        if use[i]:
            for k in range(3):
                rays[k, at], rays[3 + k, at] = m[i, k], n[i, k]
            at += 1
    scale2 = scale_rad * scale_rad
    A, g, damped, step = np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5)
    cost, damping = normal_equations(rays, R, t, scale2, rows, A, g), 1e-4
    R_new, t_new = np.empty((3, 3)), np.empty(3)
    for _ in range(iterations):
        if not damped_step(A, g, damping, damped, step):
            return
        copy_pose(R, t, R_new, t_new)
        turn(R_new, step[0], step[1], step[2])
        shift(t_new, step[3], step[4])
        cost_new = normal_equations(rays, R_new, t_new, scale2, rows, damped, step)
        if cost_new <= cost:
            gain, cost = cost - cost_new, cost_new
            copy_pose(R_new, t_new, R, t)
            A, damped = damped, A
            g, step = step, g
            damping = max(damping * 0.1, 1e-9)
            if gain <= _SETTLED_GAIN:
                return
        else:
            damping *= 10
            if damping > 1e4:
                return


@compiled
def refine_rotation(m: Floats, n: Floats, R: Floats, scale_rad: float, iterations: int) -> None:
    """Refine a rotation in place.

    The weights are the same; a Newton step takes the place of each Kabsch fit.

    Shapes: ``m, n`` (N, 3), ``R`` (3, 3).
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
            a0, a1, a2 = rotated(R, m, i)
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
