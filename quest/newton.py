"""Gauss-Newton on the quartics: what the linear algebra of the solvers leaves, in one or two steps.

The eigenproblems treat the monomials as unknowns of their own, so that rounding and noise move them apart.
Minimizing ``|A quartics(q)|^2`` over unit q puts them together again: near a solution without noise each step
squares the error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.monomials import QUARTICS, quartics

__all__ = ["polish_on_quartics"]

Floats = NDArray[np.float64]

# Steps are cut to this angle of q in radians, 6 degrees of rotation: a larger one says that the candidate is
# false, or that its normal equations are singular, and should not send it next to another solution.
_LONGEST_STEP_RAD = 0.05

_EXPONENTS = np.array([[letters.count(a) for a in range(4)] for letters in QUARTICS])
# d/dq_a takes one letter a from each monomial and multiplies it by their number.
_LOWERED = np.maximum(_EXPONENTS[:, None, :] - np.eye(4, dtype=np.int64), 0)


def polish_on_quartics(A: Floats, q: Floats, steps: int) -> Floats:
    """Move unit quaternions (B, K, 4) towards the nearest minimum of ``|A quartics(q)|``, A (B, T, 35).

    NaN rows stay NaN.
    """
    for _ in range(steps):
        residual = quartics(q) @ A.swapaxes(-1, -2)
        J = _derivatives(q) @ A.swapaxes(-1, -2)[:, None]  # (B, K, 4, T)
        # Along q nothing can change: leave the tangent space of the unit sphere.
        J -= q[..., None] * (q[..., None, :] @ J)
        normal = J @ J.swapaxes(-1, -2)
        scale = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-100
        # q q^T makes the matrix regular along q, a rounding error of its trace where nothing else does.
        normal += scale * (q[..., :, None] * q[..., None, :] + 1e-15 * np.eye(4))
        step = _solve(normal, J @ residual[..., None])[..., 0]
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        q = q - step * np.minimum(1.0, _LONGEST_STEP_RAD / np.maximum(length, _LONGEST_STEP_RAD))
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return q


def _derivatives(q: Floats) -> Floats:
    """Derivatives (..., 4, 35) of the quartic monomials by w, x, y, z."""
    powers = q[..., None] ** np.arange(5)  # (..., 4, 5): letter, exponent
    factors = powers[..., np.arange(4), _LOWERED]  # (..., 35, 4, 4)
    return np.asarray((_EXPONENTS * factors.prod(axis=-1)).swapaxes(-1, -2))


def _solve(matrices: Floats, right: Floats) -> Floats:
    """``np.linalg.solve``, with NaN for matrices that hold NaN."""
    known = np.isfinite(matrices).all(axis=(-1, -2), keepdims=True)
    return np.where(known, np.linalg.solve(np.where(known, matrices, np.eye(4)), right), np.nan)
