r"""Robust refinement of a relative pose on all of its matches.

With a = R m, e = n . (t x a), p = t . a and s = t . n (all unit vectors), the Sampson error of a match of bearings is
::

    r = e / sqrt(2 - p^2 - s^2 - 2 e^2)

The denominator is the norm of the gradient of e with respect to both unit bearings, each moved on its sphere. r is in
radians and has the standard deviation of the noise of one bearing. With R perturbed to exp(w) R and t to t + B b, B a
basis of the plane orthogonal to t, the derivatives are ::

    de = w . (a x (n x t)) + (a x n) . B b,    dp = w . (a x t) + a . B b,    ds = n . B b.

The five unknowns are found by damped steps of re-weighted least squares, with the loss of :mod:`quest.robust.loss`: the
readable counterpart of the compiled refinement.
"""

import numpy as np
from numpy.typing import NDArray

from quest.geometry.epipolar import tangent_basis
from quest.geometry.quaternion import rotation_from_vector
from quest.robust.loss import log_likelihoods, weights

Floats = NDArray[np.float64]


def sampson_jacobian(R: Floats, t: Floats, m: Floats, n: Floats) -> tuple[Floats, Floats]:
    """Sampson errors and their derivatives by (w, b), see the module docstring.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``m, n`` (N, 3), returns ``r`` (N,), returns ``J`` (N, 5).

    * Returns ``J``: Derivatives by the rotation vector w (three columns) and by the coordinates b of t (two columns).
    """
    a = m @ R.T
    axn = np.cross(a, n)
    e = axn @ t
    p, s = a @ t, n @ t
    # D vanishes only where a match lies on both epipoles. Such a match has no information; the bound avoids a division
    # by zero.
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
    """Maximize the likelihood of the Sampson errors, starting from R, t.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``m, n`` (N, 3), returns ``R`` (3, 3), returns ``t`` (3,).

    * ``scale_rad``: Scale of the loss. One radian makes it that of least squares.
    * ``iterations``: Largest number of steps. The loop ends earlier where a step changes nothing.
    * Returns ``R``: Rotation of the refined pose, whose likelihood is never less than that of the start.
    """
    r, J = sampson_jacobian(R, t, m, n)
    cost, damping = _cost(r, scale_rad), 1e-4
    for _ in range(iterations):
        weighted = J * weights(r, scale_rad)[:, None]
        A, g = J.T @ weighted, weighted.T @ r
        trace = np.trace(A)
        if not np.isfinite(trace) or trace <= 0:
            break
        A[np.diag_indices(5)] += damping * np.diag(A) + 1e-12 * trace
        step = -np.linalg.solve(A, g)
        step /= max(1.0, float(np.abs(step).max()))  # a radian: the derivatives are not valid beyond
        R_new = rotation_from_vector(step[:3]) @ R
        t_new = t + tangent_basis(t) @ step[3:]
        t_new = t_new / np.linalg.norm(t_new)
        r_new, J_new = sampson_jacobian(R_new, t_new, m, n)
        cost_new = _cost(r_new, scale_rad)
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


def _cost(r: Floats, scale_rad: float) -> float:
    """Logarithm of the likelihood of exact matches less that of the residuals r (N,)."""
    return float(np.sum(log_likelihoods(np.zeros(1), scale_rad) - log_likelihoods(r, scale_rad)))
