r"""Refinement of a relative pose on all its matches, robustly.

With a = R m, e = n . (t x a), p = t . a and s = t . n (all unit vectors), the Sampson error of a match of bearings is

    r = e / sqrt(2 - p^2 - s^2 - 2 e^2)

(the squared gradient of e with respect to both unit bearings, moved on their spheres). It is in radians and has the
standard deviation of one bearing's noise. Perturbing R to exp(w) R and t to t + B b, B a basis of the plane orthogonal
to t,

    de = w . (a x (n x t)) + (a x n) . B b,    dp = w . (a x t) + a . B b,    ds = n . B b.

Five unknowns, a damped Gauss-Newton step each, weights of Geman and McClure (they fade with the fourth power, so that
gross outliers have no say).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import rotation_from_vector

__all__ = ["refine_pose", "refine_rotation", "sampson_jacobian", "tangent_basis"]

Floats = NDArray[np.float64]


def tangent_basis(t: Floats) -> Floats:
    """Orthonormal bases (..., 3, 2) of the planes orthogonal to vectors (..., 3) of any norm but zero."""
    helper = np.eye(3)[np.argmin(np.abs(t), axis=-1)]
    first = np.cross(t, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(t, first)
    return np.stack([first, second / np.linalg.norm(second, axis=-1, keepdims=True)], axis=-1)


def sampson_jacobian(R: Floats, t: Floats, m: Floats, n: Floats) -> tuple[Floats, Floats]:
    """Sampson errors (N,) in radians and their derivatives (N, 5) by (w, b), see the module docstring.

    Parameters
    ----------
    R : (3, 3) float
    t : (3,) float
        Unit norm.
    m, n : (N, 3) float
        Unit bearings.
    """
    a = m @ R.T
    axn = np.cross(a, n)
    e = axn @ t
    p, s = a @ t, n @ t
    # D vanishes only where a match lies on both epipoles: it says nothing there, and must not divide by zero.
    D = np.maximum(2 - p * p - s * s - 2 * e * e, 1e-12)
    B = tangent_basis(t)
    # a x (n x t) = n (a.t) - t (a.n);  a x t.
    de = np.concatenate([n * p[:, None] - t * np.einsum("ij,ij->i", a, n)[:, None], axn @ B], axis=1)
    dp = np.concatenate([np.cross(a, t), a @ B], axis=1)
    ds = np.concatenate([np.zeros((len(m), 3)), n @ B], axis=1)
    dD = -2 * p[:, None] * dp - 2 * s[:, None] * ds - 4 * e[:, None] * de
    root = np.sqrt(D)
    return e / root, de / root[:, None] - (0.5 * e / (D * root))[:, None] * dD


def refine_pose(
    R: Floats, t: Floats, m: Floats, n: Floats, scale_rad: float, iterations: int = 12
) -> tuple[Floats, Floats]:
    """Minimize the robust sum of squared Sampson errors, starting from R, t.

    Parameters
    ----------
    R : (3, 3) float
    t : (3,) float
        Unit norm.
    m, n : (N, 3) float
        Unit bearings.
    scale_rad : float
        Scale of the Geman-McClure kernel: a match at this error has a quarter of the weight.
    iterations : int
        At most; stops where a step changes nothing.

    Returns
    -------
    R, t
        t has unit norm. Never worse than the start in the robust cost.
    """
    scale2 = scale_rad * scale_rad

    def cost_of(r: Floats) -> float:
        r2 = r * r
        return float(np.sum(r2 / (scale2 + r2)))

    r, J = sampson_jacobian(R, t, m, n)
    cost, damping = cost_of(r), 1e-4
    for _ in range(iterations):
        weight = 1 / (1 + r * r / scale2) ** 2
        Jw = J * weight[:, None]
        A, g = J.T @ Jw, Jw.T @ r
        trace = np.trace(A)
        if not np.isfinite(trace) or trace <= 0:
            break
        A[np.diag_indices(5)] += damping * np.diag(A) + 1e-12 * trace
        step = -np.linalg.solve(A, g)
        R_new = rotation_from_vector(step[:3]) @ R
        t_new = t + tangent_basis(t) @ step[3:]
        t_new = t_new / np.linalg.norm(t_new)
        r_new, J_new = sampson_jacobian(R_new, t_new, m, n)
        cost_new = cost_of(r_new)
        if cost_new <= cost:
            gain = cost - cost_new
            R, t, r, J, cost = R_new, t_new, r_new, J_new, cost_new
            damping = max(damping * 0.1, 1e-9)
            if gain <= 1e-9 * max(cost, 1e-30):
                break
        else:
            damping *= 10
            if damping > 1e4:
                break
    return R, t


def refine_rotation(R: Floats, m: Floats, n: Floats, scale_rad: float, iterations: int = 10) -> Floats:
    """Robust rotation ``n = R m``: iteratively re-weighted Kabsch with the weights of :func:`refine_pose`.

    ``scale_rad`` is compared with ``|n - R m| / sqrt(2)``, which has the noise of one bearing per component.
    """
    for _ in range(iterations):
        r2 = 0.5 * np.sum((n - m @ R.T) ** 2, axis=1)
        weight = 1 / (1 + r2 / (scale_rad * scale_rad)) ** 2
        U, _, Vt = np.linalg.svd((n * weight[:, None]).T @ m)
        R_new = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        change = np.abs(R_new - R).max()
        R = R_new
        if change < 1e-12:
            break
    return R
