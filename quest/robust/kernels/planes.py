"""The plane that explains most matches of a motion, its homography, and lines among rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import eigen_in_place, median_in_place, rotated, solve_in_place, tangents
from quest.jit import compiled, part
from quest.robust.kernels.local_optimization import draw_subset

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@compiled
def best_plane(m: Floats, n: Floats, R: Floats, t: Floats, limit: float, uniform: Floats, k: Floats) -> bool:
    """The plane ``k . X = 1`` of least truncated cost among those that three matches propose.

    The inverse depth of a point on the plane is k . m: project n x (R m + t (k . m)) = 0 on the epipolar line.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), ``uniform`` (S, 3), ``k`` (3,).

    * ``limit``: Displacement along the epipolar line above which a match is off the plane, radians.
    """
    count = len(m)
    lhs, gain, root, sample = np.empty(count), np.empty(count), np.empty(count), np.empty(3, np.int64)
    for i in range(count):
        n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
        a0, a1, a2 = rotated(R, m, i)
        x, y, z = n1 * t[2] - n2 * t[1], n2 * t[0] - n0 * t[2], n0 * t[1] - n1 * t[0]
        lhs[i] = -(x * (n1 * a2 - n2 * a1) + y * (n2 * a0 - n0 * a2) + z * (n0 * a1 - n1 * a0))
        gain[i] = x * x + y * y + z * z
        root[i] = np.sqrt(max(gain[i], 1e-300))
    lowest = np.inf
    for trial in range(len(uniform)):
        draw_subset(uniform[trial], count, sample)
        i, j, h = sample[0], sample[1], sample[2]
        a0, a1, a2 = gain[i] * m[i, 0], gain[i] * m[i, 1], gain[i] * m[i, 2]
        b0, b1, b2 = gain[j] * m[j, 0], gain[j] * m[j, 1], gain[j] * m[j, 2]
        c0, c1, c2 = gain[h] * m[h, 0], gain[h] * m[h, 1], gain[h] * m[h, 2]
        bc0, bc1, bc2 = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
        det = a0 * bc0 + a1 * bc1 + a2 * bc2
        if not abs(det) > 1e-30:
            continue
        # Cramer's rule: the inverse has the columns b x c, c x a, a x b.
        p, q, r = lhs[i] / det, lhs[j] / det, lhs[h] / det
        k0 = p * bc0 + q * (c1 * a2 - c2 * a1) + r * (a1 * b2 - a2 * b1)
        k1 = p * bc1 + q * (c2 * a0 - c0 * a2) + r * (a2 * b0 - a0 * b2)
        k2 = p * bc2 + q * (c0 * a1 - c1 * a0) + r * (a0 * b1 - a1 * b0)
        cost = 0.0
        for i in range(count):
            # Displacement along the epipolar line, in units of the noise of one bearing.
            inverse_depth = k0 * m[i, 0] + k1 * m[i, 1] + k2 * m[i, 2]
            cost += min(abs(inverse_depth * root[i] - lhs[i] / root[i]) / np.sqrt(2.0), limit)
            if not cost < lowest:
                break
        if cost < lowest:
            lowest = cost
            k[0], k[1], k[2] = k0, k1, k2
    return lowest < np.inf


@part
def _transferred(H: Floats, m: Floats, n: Floats, i: int) -> tuple[float, float, float]:
    """Residual of match i, as :func:`quest.geometry.homography.homography_residuals`."""
    a0, a1, a2 = rotated(H, m, i)
    norm = max(np.sqrt(a0 * a0 + a1 * a1 + a2 * a2), 1e-300)
    n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
    d0, d1, d2 = a0 / norm - n0, a1 / norm - n1, a2 / norm - n2
    along = d0 * n0 + d1 * n1 + d2 * n2
    half = np.sqrt(0.5)
    return half * (d0 - along * n0), half * (d1 - along * n1), half * (d2 - along * n2)


@part
def _fit_homography(m: Floats, n: Floats, use: Bools, H: Floats) -> None:
    """Fit a homography H of unit norm by linear least squares, ``n x H m = 0``."""
    A, V = np.empty((9, 9)), np.empty((9, 9))
    # The two tangents of n are the rows of a matrix B with B^T B = 1 - n n^T. The sum of the squared equations is that
    # of the Kronecker products of 1 - n n^T and m m^T: both are symmetric, with six different entries each.
    sums, first, second = np.zeros((6, 6)), np.empty(6), np.empty(6)
    for i in range(len(m)):
        if not use[i]:
            continue
        x, y, z, u, v, w = n[i, 0], n[i, 1], n[i, 2], m[i, 0], m[i, 1], m[i, 2]
        first[0], first[1], first[2] = 1 - x * x, -x * y, -x * z
        first[3], first[4], first[5] = 1 - y * y, -y * z, 1 - z * z
        second[0], second[1], second[2], second[3], second[4], second[5] = u * u, u * v, u * w, v * v, v * w, w * w
        for a in range(6):
            for b in range(6):
                sums[a, b] += first[a] * second[b]
    entry = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
    for a in range(3):
        for b in range(3):
            for c in range(3):
                for d in range(3):
                    A[3 * a + c, 3 * b + d] = sums[entry[a][b], entry[c][d]]
    least = eigen_in_place(A, V)
    for a in range(3):
        for c in range(3):
            H[a, c] = V[3 * a + c, least]
    # Points lie in front of both cameras, so most H m point along n.
    balance = 0
    for i in range(len(m)):
        if not use[i]:
            continue
        a0, a1, a2 = rotated(H, m, i)
        balance += 1 if n[i, 0] * a0 + n[i, 1] * a1 + n[i, 2] * a2 > 0 else -1
    if balance < 0:
        for a in range(3):
            for c in range(3):
                H[a, c] = -H[a, c]


@compiled
def fit_plane(
    m: Floats, n: Floats, t: Floats, noise_rad: float, sigmas: float, least: int, H: Floats, on_plane: Bools
) -> tuple[int, float]:
    """Refine the homography of a plane on its matches, as :func:`quest.robust.plane.fit_plane`.

    Shapes: ``m, n`` (N, 3), ``t`` (3,), ``H`` (3, 3), ``on_plane`` (N,).

    * ``sigmas``: Gate of the matches on the plane, in standard deviations of a residual.
    * Returns ``depth_variation``: See :class:`quest.robust.plane.PlaneFit`; infinite where there is no plane.
    """
    count = len(m)
    gate2 = 2 * (sigmas * noise_rad) ** 2
    on, depth_variation = 0, 0.0
    for step in range(4):
        if step > 0:
            _fit_homography(m, n, on_plane, H)
        on = 0
        for i in range(count):
            d0, d1, d2 = _transferred(H, m, n, i)
            on_plane[i] = d0 * d0 + d1 * d1 + d2 * d2 < (gate2 if step > 0 else 2 * gate2)
            on += on_plane[i]
        # Where most points lie off the plane, they refute its other motion.
        if step < 3 and on < max(least, 0.5 * count):
            return on, np.inf
    for i in range(count):
        d0, d1, d2 = _transferred(H, m, n, i)
        # (n x t) x n, the direction of the epipolar line.
        s = n[i, 0] * t[0] + n[i, 1] * t[1] + n[i, 2] * t[2]
        l0, l1, l2 = t[0] - s * n[i, 0], t[1] - s * n[i, 1], t[2] - s * n[i, 2]
        along = (d0 * l0 + d1 * l1 + d2 * l2) / max(np.sqrt(l0 * l0 + l1 * l1 + l2 * l2), 1e-300)
        depth_variation += min((along / noise_rad) ** 2, sigmas * sigmas)
    return on, depth_variation


@compiled
def off_line(rays: Floats, sigmas: float) -> float:
    """Distance of unit rays from their best great circle, as a standard deviation by the median.

    The weight of a ray falls with its distance, so that a few rays off the line do not tilt it. The distance is zero
    for points on a line.

    Shapes: ``rays`` (N, 3).
    """
    count = len(rays)
    distance, values, A, V = np.empty(count), np.empty(count), np.empty((3, 3)), np.empty((3, 3))
    middle, scale = 0.0, np.inf
    # A few rays off the line, outliers among them, must not tilt it: their weight falls with each step.
    for step in range(4):
        A00 = A01 = A02 = A11 = A12 = A22 = 0.0
        for i in range(count):
            x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
            weight = 1.0
            if step > 0:
                share = 1 / (1 + (distance[i] / (sigmas * scale)) ** 2)
                weight = share * share
            A00, A01, A02 = A00 + weight * x * x, A01 + weight * x * y, A02 + weight * x * z
            A11, A12, A22 = A11 + weight * y * y, A12 + weight * y * z, A22 + weight * z * z
        A[0, 0], A[0, 1], A[0, 2], A[1, 0], A[1, 1], A[1, 2] = A00, A01, A02, A01, A11, A12
        A[2, 0], A[2, 1], A[2, 2] = A02, A12, A22
        least = eigen_in_place(A, V)
        for i in range(count):
            distance[i] = abs(rays[i, 0] * V[0, least] + rays[i, 1] * V[1, least] + rays[i, 2] * V[2, least])
            values[i] = distance[i]
        middle = median_in_place(values)
        scale = max(1.4826 * middle, 1e-12)
    return 1.4826 * middle


@compiled
def planar_information(m: Floats, n: Floats, R: Floats, t: Floats, gate_rad: float) -> tuple[Floats, float, float]:
    """Sums over the residuals r of a homography ``R + t k^T`` and their derivatives J.

    The plane k is fitted. The residuals are those of :func:`quest.geometry.homography.homography_residuals`, two for a
    match; the unknowns are those of a pose, then k, see :func:`quest.covariance.planar_pose_covariance`.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), returns ``information`` (8, 8).
    """
    A, k, information, J = np.zeros((3, 3)), np.zeros(3), np.zeros((8, 8)), np.empty(8)
    # n x (R m + t (k . m)) = 0 is linear in k: the normal equations.
    for i in range(len(m)):
        n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
        a0, a1, a2 = rotated(R, m, i)
        x, y, z = n1 * t[2] - n2 * t[1], n2 * t[0] - n0 * t[2], n0 * t[1] - n1 * t[0]
        side = x * (n1 * a2 - n2 * a1) + y * (n2 * a0 - n0 * a2) + z * (n0 * a1 - n1 * a0)
        for j in range(3):
            k[j] -= side * m[i, j]
            for h in range(3):
                A[j, h] += (x * x + y * y + z * z) * m[i, j] * m[i, h]
    if not solve_in_place(A, k):
        for j in range(3):
            k[j] = 0.0
    x, y, z, u, v, w = tangents(t)
    psi2 = slope = 0.0
    for i in range(len(m)):
        inverse_depth = k[0] * m[i, 0] + k[1] * m[i, 1] + k[2] * m[i, 2]
        a0, a1, a2 = rotated(R, m, i)
        y0, y1, y2 = a0 + inverse_depth * t[0], a1 + inverse_depth * t[1], a2 + inverse_depth * t[2]
        scale = 1 / np.sqrt(2 * (y0 * y0 + y1 * y1 + y2 * y2))
        b0, b1, b2, c0, c1, c2 = tangents(n[i])
        # On its line y / |y| is n up to the noise, so that the residuals are its two components tangent to n.
        for second in (False, True):
            e0, e1, e2 = scale * b0, scale * b1, scale * b2
            if second:
                e0, e1, e2 = scale * c0, scale * c1, scale * c2
            J[0], J[1], J[2] = a1 * e2 - a2 * e1, a2 * e0 - a0 * e2, a0 * e1 - a1 * e0
            J[3] = inverse_depth * (e0 * x + e1 * y + e2 * z)
            J[4] = inverse_depth * (e0 * u + e1 * v + e2 * w)
            along = e0 * t[0] + e1 * t[1] + e2 * t[2]
            J[5], J[6], J[7] = along * m[i, 0], along * m[i, 1], along * m[i, 2]
            r = e0 * y0 + e1 * y1 + e2 * y2
            share = r * r / (gate_rad * gate_rad)
            weight = 1 / ((1 + share) * (1 + share))
            psi2 += r * r * weight * weight
            slope += (1 - 3 * share) * weight / (1 + share)
            for j in range(8):
                for h in range(8):
                    information[j, h] += J[j] * J[h]
    return information, psi2, slope
