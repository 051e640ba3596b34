"""The sums over matches of the parallax test and of a pose's covariance, and the depths of the matches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import median_in_place, rotated, tangents
from quest.jit import compiled
from quest.robust.kernels.noise import LEAST_SINE2, mark_typical
from quest.robust.kernels.refinement import normal_equations, refine_rotation
from quest.robust.kernels.scoring import rays_by_row

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Squared scale of a kernel that gives all residuals the weight 1.
_NO_KERNEL = 1e300


@compiled
def pose_information(
    m: Floats, n: Floats, R: Floats, t: Floats, gate_rad: float
) -> tuple[Floats, float, float, float, float]:
    """Sums over the Sampson errors r of matches and their derivatives J: J^T J, r^2, psi^2, psi' and psi'^2.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), returns ``information`` (5, 5).
    """
    count = len(m)
    rays, rows, information = rays_by_row(m, n), np.empty((7, count)), np.empty((5, 5))
    normal_equations(rays, R, t, _NO_KERNEL, rows, information, np.empty(5))
    squares = psi2 = slope = slope2 = 0.0
    for i in range(count):
        r2 = rows[5, i] * rows[5, i]
        u = r2 / (gate_rad * gate_rad)
        weight = 1 / (1 + u)
        squares += r2
        psi2 += r2 * weight * weight
        one = (1 - u) * weight * weight
        slope += one
        slope2 += one * one
    return information, squares, psi2, slope, slope2


@compiled
def rotation_of_all(m: Floats, n: Floats, R: Floats, noise_rad: float, iterations: int) -> None:
    """The best rotation of matches with parallax, in place.

    Shapes: ``m, n`` (N, 3), ``R`` (3, 3).
    """
    values, last = np.empty(len(m)), np.inf
    # The scale falls from the median residual to the noise, so that a scene with parallax is first fitted as a whole.
    for _ in range(8):
        for i in range(len(m)):
            a0, a1, a2 = rotated(R, m, i)
            values[i] = (n[i, 0] - a0) ** 2 + (n[i, 1] - a1) ** 2 + (n[i, 2] - a2) ** 2
        scale = max(2 * noise_rad, np.sqrt(0.5 * median_in_place(values)))
        if scale > 0.99 * last:  # the scale falls no further
            break
        refine_rotation(m, n, R, scale, iterations)
        last = scale


@compiled
def anisotropy_sums(
    m: Floats, n: Floats, R: Floats, t: Floats, near_rad: float, far_rad: float, least_rad: float
) -> tuple[Floats, int, int, int]:
    """Sums over the near matches, from which the test value of a translation follows.

    Shapes: ``m, n`` (N, 3), ``R`` (3, 3), ``t`` (3,), returns ``sums`` (5, 3).

    * ``near_rad, far_rad``: Displacements per component below which a match is near, and above which it is far.
    * Returns ``sums``: J^T J and J^T y, with y the components of the displacements across the epipolar lines and J
      their derivatives by a small rotation: y = J w. The last row are the sums of |d|^2, of |d|^4 and of y^2, d the
      displacements.
    * Returns ``count``: Number of matches in the sums: those that are near and have a usable ray.
    """
    near = far = count = 0
    A00 = A01 = A02 = A11 = A12 = A22 = g0 = g1 = g2 = 0.0
    total = fourth = across2 = 0.0
    for i in range(len(m)):
        a0, a1, a2 = rotated(R, m, i)
        d0, d1, d2 = n[i, 0] - a0, n[i, 1] - a1, n[i, 2] - a2
        along = d0 * a0 + d1 * a1 + d2 * a2
        d0, d1, d2 = d0 - along * a0, d1 - along * a1, d2 - along * a2
        square = d0 * d0 + d1 * d1 + d2 * d2
        if square > 2 * far_rad * far_rad:
            far += 1
        if not square < 2 * near_rad * near_rad:
            continue
        near += 1
        x, y, z = a1 * t[2] - a2 * t[1], a2 * t[0] - a0 * t[2], a0 * t[1] - a1 * t[0]
        sine2 = x * x + y * y + z * z
        if not sine2 > LEAST_SINE2:
            continue
        count += 1
        length = np.sqrt(sine2)
        x, y, z = x / length, y / length, z / length
        total += square
        fourth += max(square, least_rad * least_rad) ** 2
        value = x * d0 + y * d1 + z * d2
        across2 += value * value
        # across . (w x a) = w . (a x across)
        J0, J1, J2 = a1 * z - a2 * y, a2 * x - a0 * z, a0 * y - a1 * x
        g0, g1, g2 = g0 + J0 * value, g1 + J1 * value, g2 + J2 * value
        A00, A01, A02 = A00 + J0 * J0, A01 + J0 * J1, A02 + J0 * J2
        A11, A12, A22 = A11 + J1 * J1, A12 + J1 * J2, A22 + J2 * J2
    sums = np.empty((5, 3))
    sums[0, 0], sums[0, 1], sums[0, 2], sums[1, 0], sums[1, 1], sums[1, 2] = A00, A01, A02, A01, A11, A12
    sums[2, 0], sums[2, 1], sums[2, 2], sums[3, 0], sums[3, 1], sums[3, 2] = A02, A12, A22, g0, g1, g2
    sums[4, 0], sums[4, 1], sums[4, 2] = total, fourth, across2
    return sums, count, near, far


@compiled
def ratio_sums(m: Floats, n: Floats, R: Floats, t: Floats) -> tuple[float, float, Floats, Floats]:
    """Sums over the matches, from which the ratio |t| / depth and its deviation follow.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), returns ``sums`` (7,), returns ``noise`` (2, 2).

    * Returns ``shift, weight``: Sums of ``(n - a) . l`` and of ``|l|^2`` over the matches of typical depth, with a = R
      m and l the part of t orthogonal to n. Their quotient is the ratio.
    * Returns ``sums``: Sums over these matches: a x l, the coordinates of n - a in the tangents of t, those of l.
    * Returns ``noise``: Mean contribution of noise to the information about the direction of t, in units of twice its
      variance, of all matches.
    """
    typical = np.ones(len(m), np.bool_)
    mark_typical(m, n, R, t, typical)
    x, y, z, u, v, w = tangents(t)
    weight = shift = noise00 = noise01 = noise11 = 0.0
    turn0 = turn1 = turn2 = part0 = part1 = part2 = line0 = line1 = line2 = 0.0
    for i in range(len(m)):
        a0, a1, a2 = rotated(R, m, i)
        n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
        p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n0 * t[0] + n1 * t[1] + n2 * t[2]
        share = 1 / max(2 - p * p - s * s, 1e-12)
        first, second = a0 * x + a1 * y + a2 * z, a0 * u + a1 * v + a2 * w
        noise00 += share * (1 - first * first)
        noise01 -= share * first * second
        noise11 += share * (1 - second * second)
        if not typical[i]:
            continue
        l0, l1, l2 = t[0] - s * n0, t[1] - s * n1, t[2] - s * n2
        weight += l0 * l0 + l1 * l1 + l2 * l2
        shift += (n0 - a0) * l0 + (n1 - a1) * l1 + (n2 - a2) * l2
        turn0, turn1, turn2 = turn0 + a1 * l2 - a2 * l1, turn1 + a2 * l0 - a0 * l2, turn2 + a0 * l1 - a1 * l0
        part0, part1, part2 = part0 + n0 - a0, part1 + n1 - a1, part2 + n2 - a2
        line0, line1, line2 = line0 + l0, line1 + l1, line2 + l2
    sums, noise = np.empty(7), np.empty((2, 2))
    sums[0], sums[1], sums[2] = turn0, turn1, turn2
    sums[3], sums[4] = part0 * x + part1 * y + part2 * z, part0 * u + part1 * v + part2 * w
    sums[5], sums[6] = line0 * x + line1 * y + line2 * z, line0 * u + line1 * v + line2 * w
    noise[0, 0], noise[0, 1], noise[1, 0], noise[1, 1] = noise00, noise01, noise01, noise11
    return shift, weight, sums, noise


@compiled
def depths_and_parallax(m: Floats, n: Floats, R: Floats, t: Floats, inliers: Bools) -> tuple[Floats, float]:
    """Depths of the inliers along their rays, and the median angle between their rays.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), ``inliers`` (N,), returns ``depths`` (2, N).

    * Returns ``depths``: Depths in camera 1 and camera 2, see :func:`quest.geometry.epipolar.depths_from_pose`; NaN for
      the other matches.
    """
    depths, angles, count = np.empty((2, len(m))), np.empty(len(m)), 0
    for i in range(len(m)):
        depths[0, i] = depths[1, i] = np.nan
        if not inliers[i]:
            continue
        a0, a1, a2 = rotated(R, m, i)
        c = a0 * n[i, 0] + a1 * n[i, 1] + a2 * n[i, 2]
        p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n[i, 0] * t[0] + n[i, 1] * t[1] + n[i, 2] * t[2]
        depths[0, i], depths[1, i] = (1 - s) * (1 + s) / (c * s - p), (1 - p) * (1 + p) / (s - c * p)
        angles[count] = np.arccos(min(1.0, max(-1.0, c)))
        count += 1
    return depths, median_in_place(angles[:count])
