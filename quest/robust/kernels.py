r"""The inner loops of robust estimation, compiled.

Each function has a readable counterpart in numpy that the tests compare it with: :func:`score` and :func:`residuals`
with :class:`quest.robust.pose_problem.RelativePoseProblem`, :func:`refine` with :func:`quest.geometry.refine.refine_pose`,
:func:`refine_rotation` with :func:`quest.geometry.refine.refine_rotation`, :func:`newton_five` with the definition of its roots.
Compiled they are 20 to 100 times faster, since a sample needs some hundred operations on three numbers each, which
arrays of that size do not pay for. numba compiles at the first call and keeps the machine code on disk; it is imported
here and nowhere else, and this module only where an estimation starts. All loops stand in one file, since the machine
code on disk is renewed when its own file changes, not when one that it calls into does. No fast-math and no threads:
same input, same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.

References
----------
.. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", 2017.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "newton_five",
    "refine",
    "refine_model",
    "refine_rotation",
    "residuals",
    "residuals_of_model",
    "score",
    "try_samples",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Newton's method doubles the digits at each step, so that ten steps are three or four to get near and the rest to
#: settle. A start that has not settled by then circles.
_NEWTON_STEPS = 10
#: After four steps a start that will settle is within this of a root: one in 300 of those that do is not.
_NOT_NEAR = 0.1
#: |n . (t x R m)| from which on a root counts as found: a thousandth of the noise of the best features.
_ROOT = 1e-7
#: A step below this, a thousandth of the noise of the best features, changes nothing that can be told.
_SETTLED_RAD = 1e-8
#: Longest step of the rotation (radians); of the direction twice as much. Beyond it the linearization is not valid.
_LONGEST_STEP = 0.3
#: Logarithm of the likelihood ratio at which a model is given up: one good one in a hundred is.
_REFUTED = -4.6
#: Two models of a pool nearer than this (radians, rotation plus direction) are one mode: models from five noisy
#: matches scatter by several degrees about theirs.
_SAME_MODE_RAD = 0.26


Function = TypeVar("Function", bound=Callable[..., object])


def _compiled(function: Function) -> Function:
    """The function compiled at its first call, its machine code kept on disk."""
    try:
        return cast("Function", njit(cache=True, error_model="numpy")(function))
    except RuntimeError:
        # No folder can be written, neither the package's nor the user's: each process compiles for itself.
        return cast("Function", njit(error_model="numpy")(function))


@_compiled
def _tangents(t: Floats) -> tuple[float, float, float, float, float, float]:
    """Two orthonormal vectors orthogonal to the unit vector t; as :func:`quest.geometry.refine.tangent_basis`."""
    k = 0
    if abs(t[1]) < abs(t[k]):
        k = 1
    if abs(t[2]) < abs(t[k]):
        k = 2
    if k == 0:
        x, y, z = 0.0, t[2], -t[1]
    elif k == 1:
        x, y, z = -t[2], 0.0, t[0]
    else:
        x, y, z = t[1], -t[0], 0.0
    norm = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / norm, y / norm, z / norm
    return x, y, z, t[1] * z - t[2] * y, t[2] * x - t[0] * z, t[0] * y - t[1] * x


@_compiled
def _turn(R: Floats, w0: float, w1: float, w2: float) -> None:
    """``R <- exp([w]x) R`` in place, through the unit quaternion of w."""
    angle = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    half = 0.5 * angle
    # sin(x)/x to second order is exact to machine precision below 1e-4.
    s = np.sin(half) / angle if angle > 1e-4 else 0.5 - half * half / 12
    c, x, y, z = np.cos(half), s * w0, s * w1, s * w2
    for k in range(3):
        a0, a1, a2 = R[0, k], R[1, k], R[2, k]
        # v + 2 c (q x v) + 2 q x (q x v)
        b0, b1, b2 = y * a2 - z * a1, z * a0 - x * a2, x * a1 - y * a0
        R[0, k] = a0 + 2 * (c * b0 + y * b2 - z * b1)
        R[1, k] = a1 + 2 * (c * b1 + z * b0 - x * b2)
        R[2, k] = a2 + 2 * (c * b2 + x * b1 - y * b0)


@_compiled
def _solve_in_place(A: Floats, b: Floats) -> bool:
    """Gaussian elimination with row pivots; b becomes the solution. False where A is singular."""
    size = len(b)
    for c in range(size):
        p = c
        for r in range(c + 1, size):
            if abs(A[r, c]) > abs(A[p, c]):
                p = r
        if not abs(A[p, c]) > 1e-14:
            return False
        if p != c:
            for k in range(c, size):
                A[c, k], A[p, k] = A[p, k], A[c, k]
            b[c], b[p] = b[p], b[c]
        inverse = 1.0 / A[c, c]
        for r in range(c + 1, size):
            factor = A[r, c] * inverse
            for k in range(c + 1, size):
                A[r, k] -= factor * A[c, k]
            b[r] -= factor * b[c]
    for c in range(size - 1, -1, -1):
        for k in range(c + 1, size):
            b[c] -= A[c, k] * b[k]
        b[c] /= A[c, c]
    return True


@_compiled
def newton_five(m: Floats, n: Floats, rows: Ints, R: Floats, t: Floats) -> bool:
    r"""A pose that five matches obey exactly, by Newton's method from a start.

    Five matches give five equations ``n . (t x R m) = 0`` for the three unknowns of R and the two of t: the coplanarity
    of the normals ``R m x n`` that QuEst states in q alone [F17]_, with the vector they are orthogonal to as an unknown
    beside q. The derivatives are those of :mod:`quest.geometry.refine`. There are up to ten solutions and each is reached from
    somewhere; from a random direction and a rotation within 45 degrees, one start in three to ten reaches the true one.
    At a few microseconds a start that is cheaper than all solutions of one sample by eigenvalues.

    Parameters
    ----------
    m, n : (N, 3) float
    rows : (5,) int
        The sample.
    R, t : (3, 3), (3,) float
        The start; overwritten by the solution.

    Returns
    -------
    bool
        Whether a solution was found that has all five points in front of both cameras; the sign of t is the one for it.
    """
    A, b = np.empty((5, 5)), np.empty(5)
    for step in range(_NEWTON_STEPS):
        x, y, z, u, v, w = _tangents(t)
        worst = 0.0
        for i in range(5):
            m0, m1, m2 = m[rows[i], 0], m[rows[i], 1], m[rows[i], 2]
            n0, n1, n2 = n[rows[i], 0], n[rows[i], 1], n[rows[i], 2]
            a0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
            a1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
            a2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
            c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
            p, cosine = a0 * t[0] + a1 * t[1] + a2 * t[2], a0 * n0 + a1 * n1 + a2 * n2
            A[i, 0], A[i, 1], A[i, 2] = n0 * p - t[0] * cosine, n1 * p - t[1] * cosine, n2 * p - t[2] * cosine
            A[i, 3], A[i, 4] = c0 * x + c1 * y + c2 * z, c0 * u + c1 * v + c2 * w
            b[i] = -(c0 * t[0] + c1 * t[1] + c2 * t[2])
            worst = max(worst, abs(b[i]))
        if step >= 4 and worst > _NOT_NEAR:
            return False
        if worst < _ROOT:
            return _all_in_front(m, n, rows, R, t)
        if not _solve_in_place(A, b):
            return False
        turn, shift = np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2), np.sqrt(b[3] ** 2 + b[4] ** 2)
        factor = min(1.0, _LONGEST_STEP / max(turn, 0.5 * shift, 1e-300))
        _turn(R, factor * b[0], factor * b[1], factor * b[2])
        _shift(t, factor * b[3], factor * b[4], x, y, z, u, v, w)
    return False


@_compiled
def _shift(t: Floats, b0: float, b1: float, x: float, y: float, z: float, u: float, v: float, w: float) -> None:
    """``t <- t + B b`` in place, back to unit norm."""
    t0, t1, t2 = t[0] + b0 * x + b1 * u, t[1] + b0 * y + b1 * v, t[2] + b0 * z + b1 * w
    norm = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
    t[0], t[1], t[2] = t0 / norm, t1 / norm, t2 / norm


@_compiled
def _all_in_front(m: Floats, n: Floats, rows: Ints, R: Floats, t: Floats) -> bool:
    """Whether all depths have one sign; t is turned so that they are positive."""
    count = 0
    for i in rows:
        a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
        a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
        a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
        p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n[i, 0] * t[0] + n[i, 1] * t[1] + n[i, 2] * t[2]
        cosine = a0 * n[i, 0] + a1 * n[i, 1] + a2 * n[i, 2]
        # Signs of the depths, see quest.geometry.epipolar.depths_from_pose.
        if cosine * s > p and s > cosine * p:
            count += 1
        elif cosine * s < p and s < cosine * p:
            count -= 1
    if count == -len(rows):
        t[0], t[1], t[2] = -t[0], -t[1], -t[2]
    return abs(count) == len(rows)


@_compiled
def _residual(m: Floats, n: Floats, i: int, R: Floats, t: Floats, flat: float) -> tuple[float, bool]:
    """Squared Sampson error of match i, and whether it lies behind a camera beyond doubt (parallax^2 above flat)."""
    a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
    a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
    a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
    n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
    p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n0 * t[0] + n1 * t[1] + n2 * t[2]
    c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
    e = c0 * t[0] + c1 * t[1] + c2 * t[2]
    r2 = e * e / max(2 - p * p - s * s - 2 * e * e, 1e-12)
    cosine = a0 * n0 + a1 * n1 + a2 * n2
    observable = c0 * c0 + c1 * c1 + c2 * c2 > flat
    return r2, observable and (cosine * s < p or s < cosine * p)


@_compiled
def residuals(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float) -> tuple[Floats, Bools]:
    """As :meth:`quest.robust.pose_problem.RelativePoseProblem.residuals`, of one model: (N,) float and (N,) bool."""
    r2, behind = np.empty(len(m)), np.empty(len(m), np.bool_)
    for i in range(len(m)):
        r2[i], behind[i] = _residual(m, n, i, R, t, 2 * threshold_rad * threshold_rad)
    return r2, behind


@_compiled
def score(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, bail: float) -> tuple[float, int]:
    """Truncated sum of squared Sampson errors and number of inliers (MSAC); gives up once the sum exceeds ``bail``.

    Giving up loses nothing: the sum only grows.
    """
    cost, inliers, _ = _score(m, n, R, t, threshold_rad, bail, 0.0, 0.0)
    return cost, inliers


@_compiled
def _score(
    m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, bail: float, good: float, bad: float
) -> tuple[float, int, float]:
    """As :func:`score`; gives up as well where a good model is refuted, and says which share it had explained then.

    Matches are a sequence of trials, explained with probability ``good`` by a good model and ``bad`` by a bad one; the
    likelihood ratio of the two is followed (Wald's sequential test, for RANSAC: Matas and Chum, ICCV 2005) unless
    ``good`` is hardly more than ``bad``.
    """
    limit = threshold_rad * threshold_rad
    cost, inliers, evidence = 0.0, 0, 0.0
    tested = good > 1.5 * bad and bad > 0
    for_hit = np.log(good / bad) if tested else 0.0
    for_miss = np.log((1 - good) / (1 - bad)) if tested else 0.0
    for i in range(len(m)):
        r2, behind = _residual(m, n, i, R, t, 2 * limit)
        if r2 < limit and not behind:
            cost += r2
            inliers += 1
            evidence += for_hit
        else:
            cost += limit
            evidence += for_miss
            if cost > bail or evidence < _REFUTED:
                return np.inf, 0, inliers / (i + 1)
    return cost, inliers, inliers / len(m)


@_compiled
def _normal_equations(
    m: Floats, n: Floats, use: Bools, R: Floats, t: Floats, scale2: float, A: Floats, g: Floats
) -> float:
    """Weighted normal equations of the Sampson errors, see :mod:`quest.geometry.refine`; returns the robust cost."""
    x, y, z, u, v, w = _tangents(t)
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
        # Derivatives of e, p and s: of the rotation, then of the direction.
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


@_compiled
def refine(m: Floats, n: Floats, use: Bools, R: Floats, t: Floats, scale_rad: float, iterations: int) -> None:
    """As :func:`quest.geometry.refine.refine_pose`, on the matches to use (N,), in place."""
    scale2 = scale_rad * scale_rad
    A, g, damped, step = np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5)
    cost, damping = _normal_equations(m, n, use, R, t, scale2, A, g), 1e-4
    R_new, t_new = np.empty((3, 3)), np.empty(3)
    for _ in range(iterations):
        trace = A[0, 0] + A[1, 1] + A[2, 2] + A[3, 3] + A[4, 4]
        if not (trace > 0 and np.isfinite(trace)):
            return
        # Scaled by the trace, so that the pivots' bound is one of condition.
        for j in range(5):
            for k in range(5):
                damped[j, k] = A[j, k] / trace
            damped[j, j] += damping * damped[j, j] + 1e-12
            step[j] = -g[j] / trace
        if not _solve_in_place(damped, step):
            return
        longest = 1.0  # a radian: what lies beyond has nothing to do with the derivatives here
        for j in range(5):
            longest = max(longest, abs(step[j]))
        for j in range(5):
            step[j] /= longest
        _copy_pose(R, t, R_new, t_new)
        x, y, z, u, v, w = _tangents(t)
        _turn(R_new, step[0], step[1], step[2])
        _shift(t_new, step[3], step[4], x, y, z, u, v, w)
        cost_new = _normal_equations(m, n, use, R_new, t_new, scale2, damped, step)
        if cost_new <= cost:
            gain, cost = cost - cost_new, cost_new
            _copy_pose(R_new, t_new, R, t)
            A, damped = damped, A
            g, step = step, g
            damping = max(damping * 0.1, 1e-9)
            if gain <= 1e-9 * max(cost, 1e-30):
                return
        else:
            damping *= 10
            if damping > 1e4:
                return


@_compiled
def _copy_pose(R: Floats, t: Floats, to_R: Floats, to_t: Floats) -> None:
    for i in range(3):
        to_t[i] = t[i]
        for j in range(3):
            to_R[i, j] = R[i, j]


@_compiled
def _matrix(model: Floats) -> Floats:
    """Rotation matrix of the unit quaternion that a model begins with; as :mod:`quest.geometry.quaternion`."""
    w, x, y, z = model[0], model[1], model[2], model[3]
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


@_compiled
def residuals_of_model(m: Floats, n: Floats, model: Floats, threshold_rad: float) -> tuple[Floats, Bools]:
    """As :func:`residuals`, of a row (q_wxyz, t)."""
    r2, behind = residuals(m, n, _matrix(model), model[4:], threshold_rad)
    return r2, behind


@_compiled
def refine_model(m: Floats, n: Floats, use: Bools, model: Floats, scale_rad: float, iterations: int) -> Floats:
    """As :func:`refine`, of a row (q_wxyz, t); returns R (9,) and t (3,) in one row."""
    R, t, pose = _matrix(model), np.empty(3), np.empty(12)
    for i in range(3):
        t[i] = model[4 + i]
    refine(m, n, use, R, t, scale_rad, iterations)
    for i in range(3):
        pose[9 + i] = t[i]
        for j in range(3):
            pose[3 * i + j] = R[i, j]
    return pose


@_compiled
def refine_rotation(m: Floats, n: Floats, R: Floats, scale_rad: float, iterations: int) -> None:
    """As :func:`quest.geometry.refine.refine_rotation`, in place: the same weights, with a Newton step for each Kabsch fit."""
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
        if not _solve_in_place(A, g):
            return
        turn = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
        factor = min(1.0, 1 / max(turn, 1e-300))  # a radian at a time: from anywhere there are few
        _turn(R, factor * g[0], factor * g[1], factor * g[2])
        if turn < _SETTLED_RAD:
            return


@_compiled
def _mode_distance(R1: Floats, t1: Floats, R2: Floats, t2: Floats) -> float:
    """Angle between two rotations plus angle between two directions, radians."""
    trace, cosine = 0.0, t1[0] * t2[0] + t1[1] * t2[1] + t1[2] * t2[2]
    for i in range(3):
        trace += R1[i, 0] * R2[i, 0] + R1[i, 1] * R2[i, 1] + R1[i, 2] * R2[i, 2]
    turn: float = np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1))))
    shift: float = np.arccos(min(1.0, max(-1.0, cosine)))
    return turn + shift


@_compiled
def try_samples(
    m: Floats,
    n: Floats,
    samples: Ints,
    rotations: Floats,
    directions: Floats,
    threshold_rad: float,
    pool_R: Floats,
    pool_t: Floats,
    pool_costs: Floats,
    pool_inliers: Ints,
    chance: Floats,
) -> None:
    """Solve samples from several starts each, score what is found, and keep the best of each mode in the pool.

    Parameters
    ----------
    m, n : (N, 3) float
        In random order: a bad model is recognized by the first of them.
    samples : (S, 5) int
    rotations : (K, 3, 3) float
    directions : (S, K, 3) float
        The starts of each sample.
    threshold_rad : float
    pool_R, pool_t, pool_costs, pool_inliers : (P, 3, 3), (P, 3), (P,) float, (P,) int
        The pool, ordered by cost (infinite where empty); updated in place.
    chance : (2,) float
        The share of matches that models explain, summed over all models so far, and their number; updated in place.
    """
    size = len(pool_costs)
    R, t = np.empty((3, 3)), np.empty(3)
    found_R, found_t = np.empty((len(rotations), 3, 3)), np.empty((len(rotations), 3))
    for i in range(len(samples)):
        found = 0
        for k in range(len(rotations)):
            _copy_pose(rotations[k], directions[i, k], R, t)
            if not newton_five(m, n, samples[i], R, t):
                continue
            known = False
            for j in range(found):
                known = known or _mode_distance(R, t, found_R[j], found_t[j]) < 1e-5
            if known:
                continue
            _copy_pose(R, t, found_R[found], found_t[found])
            found += 1
            # A model from five noisy matches explains half of what it will after refinement, or more. Nearly all models
            # so far were bad ones, so they tell what those explain.
            good = 0.5 * pool_inliers[0] / len(m)
            cost, inliers, share = _score(
                m, n, R, t, threshold_rad, pool_costs[size - 1], good, chance[0] / max(chance[1], 1.0)
            )
            chance[0] += share
            chance[1] += 1
            if not cost < pool_costs[size - 1]:
                continue
            _enter_pool(R, t, cost, inliers, pool_R, pool_t, pool_costs, pool_inliers)


@_compiled
def _enter_pool(
    R: Floats,
    t: Floats,
    cost: float,
    inliers: int,
    pool_R: Floats,
    pool_t: Floats,
    pool_costs: Floats,
    pool_inliers: Ints,
) -> None:
    """Put a model in its place, for all members of its mode or else for the last one, unless one of its mode is better.

    All of them, not only the nearest: a new model between two members of the pool makes one mode of both.
    """
    size, kept = len(pool_costs), 0
    for j in range(size):
        if not pool_costs[j] < np.inf:
            break
        if _mode_distance(R, t, pool_R[j], pool_t[j]) < _SAME_MODE_RAD:
            # Those of its mode come in order of cost, so none has been taken out yet.
            if not cost < pool_costs[j]:
                return
            continue
        if kept < j:
            _copy_pose(pool_R[j], pool_t[j], pool_R[kept], pool_t[kept])
            pool_costs[kept], pool_inliers[kept] = pool_costs[j], pool_inliers[j]
        kept += 1
    for j in range(kept, size):
        pool_costs[j], pool_inliers[j] = np.inf, 0
    at = min(kept, size - 1)
    while at > 0 and cost < pool_costs[at - 1]:
        _copy_pose(pool_R[at - 1], pool_t[at - 1], pool_R[at], pool_t[at])
        pool_costs[at], pool_inliers[at] = pool_costs[at - 1], pool_inliers[at - 1]
        at -= 1
    _copy_pose(R, t, pool_R[at], pool_t[at])
    pool_costs[at], pool_inliers[at] = cost, inliers
