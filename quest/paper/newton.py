"""Gauss-Newton steps that remove the remaining error of the solvers' candidates.

The eigenproblems treat the monomials as independent unknowns, so that rounding and noise make them inconsistent.
Minimization over unit q makes them consistent again: near a solution without noise each step squares the error. The
cost is ``|A quartics(q)|^2`` or the sum of squared Sampson errors of the sample (derivatives:
:mod:`quest.robust.kernels.refinement`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.epipolar import tangent_basis
from quest.geometry.quaternion import canonical, matrix_from_quaternion, multiply, quaternion_from_vector
from quest.paper.monomials import QUARTICS, cross, quartics
from quest.paper.selection import smallest_eigenvectors

Floats = NDArray[np.float64]

# Steps are cut to this angle of q in radians, 6 degrees of rotation. A larger step means that the candidate is false or
# that its normal equations are singular; it must not take the candidate to another solution.
_LONGEST_STEP_RAD = 0.05

# Longest step of rotation and direction together. The direction is the least certain part and moves most.
_LONGEST_POSE_STEP_RAD = 0.3

_EXPONENTS = np.array([[letters.count(a) for a in range(4)] for letters in QUARTICS])
# d/dq_a takes one letter a from each monomial and multiplies it by their number.
_LOWERED = np.maximum(_EXPONENTS[:, None, :] - np.eye(4, dtype=np.int64), 0)


def polish_on_quartics(A: Floats, q: Floats, steps: int) -> Floats:
    """Move quaternions towards the nearest minimum of ``|A quartics(q)|``.

    Shapes: ``A`` (B, T, 35), ``q`` (B, K, 4), returns (B, K, 4).
    """
    for _ in range(steps):
        residual = quartics(q) @ A.swapaxes(-1, -2)
        J = _derivatives(q) @ A.swapaxes(-1, -2)[:, None]  # (B, K, 4, T)
        # Keep the part of the derivatives that is tangent to the unit sphere.
        J -= q[..., None] * (q[..., None, :] @ J)
        normal = J @ J.swapaxes(-1, -2)
        scale = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-100
        # q q^T makes the matrix regular along q. The identity times a rounding error makes it regular elsewhere.
        normal += scale * (q[..., :, None] * q[..., None, :] + 1e-15 * np.eye(4))
        step = _solve(normal, J @ residual[..., None])[..., 0]
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        q = q - step * np.minimum(1.0, _LONGEST_STEP_RAD / np.maximum(length, _LONGEST_STEP_RAD))
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return q


def polish_on_matches(q: Floats, m: Floats, n: Floats, steps: int) -> Floats:
    """Move quaternions towards the nearest minimum of the sum of squared Sampson errors.

    The translation starts as the best one of each rotation and moves with the rotation. The derivatives of the
    denominators are necessary: without them, many matches under noise settle several times as far from the truth.

    Shapes: ``q`` (B, K, 4), ``m, n`` (B, N, 3), returns (B, K, 4).
    """
    known = np.isfinite(q[..., 0])
    q = np.where(known[..., None], q, [1.0, 0.0, 0.0, 0.0])
    m, n = m[:, None], n[:, None]
    t = None
    for _ in range(steps):
        a = m @ matrix_from_quaternion(q).swapaxes(-1, -2)
        c = cross(a, n)
        if t is None:
            t = smallest_eigenvectors(c.swapaxes(-1, -2) @ c)
        column, B = t[..., None], tangent_basis(t)
        e, p, s = ((rays @ column)[..., 0] for rays in (c, a, n))
        # A match at both epipoles has no information; the bound avoids a division by zero.
        D = np.maximum(2 - p * p - s * s - 2 * e * e, 1e-12)
        # de and -dD / 2 by the rotation and by the direction.
        by_rotation = p[..., None] * n - (a * n).sum(axis=-1)[..., None] * t[..., None, :]
        J = np.concatenate([by_rotation, c @ B], axis=-1)
        dD = np.concatenate(
            [p[..., None] * cross(a, t[..., None, :]), (p[..., None] * a + s[..., None] * n) @ B], axis=-1
        )
        dD += 2 * e[..., None] * J
        J = (J + (e / D)[..., None] * dD) / np.sqrt(D)[..., None]
        normal = J.swapaxes(-1, -2) @ J
        scale = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-100
        gradient = J.swapaxes(-1, -2) @ (e / np.sqrt(D))[..., None]
        step = -np.linalg.solve(normal + 1e-12 * scale * np.eye(5), gradient)[..., 0]
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        step *= np.minimum(1.0, _LONGEST_POSE_STEP_RAD / np.maximum(length, _LONGEST_POSE_STEP_RAD))
        q = multiply(quaternion_from_vector(step[..., :3]), q)
        t = t + (B @ step[..., 3:, None])[..., 0]
        t = t / np.linalg.norm(t, axis=-1, keepdims=True)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(known[..., None], canonical(q), np.nan)


def _derivatives(q: Floats) -> Floats:
    """Derivatives (..., 4, 35) of the quartic monomials by w, x, y, z."""
    powers = q[..., None] ** np.arange(5)  # (..., 4, 5): letter, exponent
    factors = powers[..., np.arange(4), _LOWERED]  # (..., 35, 4, 4)
    return np.asarray((_EXPONENTS * factors.prod(axis=-1)).swapaxes(-1, -2))


def _solve(matrices: Floats, right: Floats) -> Floats:
    """``np.linalg.solve``, with NaN for matrices that hold NaN."""
    known = np.isfinite(matrices).all(axis=(-1, -2), keepdims=True)
    return np.where(known, np.linalg.solve(np.where(known, matrices, np.eye(4)), right), np.nan)
