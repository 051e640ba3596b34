"""The seven-point algorithm on calibrated rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.benchmarks.quest.baselines.essential import as_samples, finish, null_space, rotations_of_essential

Floats = NDArray[np.float64]

# det(c A + s B) is a cubic form in (c, s). Its values at four angles determine it.
_ANGLES = np.pi * np.arange(4) / 4
_NODES = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_COEFFICIENTS = np.linalg.inv([[c**3, c * c * s, c * s * s, s**3] for c, s in _NODES])

# A root is complex where |imaginary| / |root| exceeds this bound: rounding separates a double root by sqrt(1e-16).
_REAL = 1e-7


def seven_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the singular matrices ``n . E m = 0`` that seven matches allow.

    The matrices of the pencil E = c A + s B with det E = 0 are the solutions, at most three. Each gives the rotations
    of the nearest essential matrix. For points on a plane the pencil has three dimensions, and the rotations are wrong.

    R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 11.1.2.

    Shapes: ``m, n`` (N, 3), returns (K, 4).

    * ``m, n``: Bearings in camera 1 and camera 2, of any norm, N >= 7; more than seven in least squares.
    * Returns: Unit quaternions wxyz, canonical in sign, in the form of :func:`quest.paper.quest6`.
    """
    m, n, single = as_samples(m, n, at_least=7)
    pencil = null_space(m, n, 2)
    values = np.linalg.det(np.tensordot(_NODES, pencil, axes=(1, 1)).swapaxes(0, 1))
    c, s = np.moveaxis(_roots(values @ _COEFFICIENTS.T), -1, 0)
    E = c[..., None, None] * pencil[:, None, 0] + s[..., None, None] * pencil[:, None, 1]
    return finish(rotations_of_essential(E).reshape(len(m), 6, 4), m, n, single)


def _roots(form: Floats) -> Floats:
    """Real roots (B, 3, 2) of cubic forms (B, 4) ``c^3, c^2 s, c s^2, s^3`` on the unit circle; NaN if complex."""
    # Divide by the larger of the first and the last coefficient, so that no root is infinite: the unknown is c/s or
    # s/c.
    swap = np.abs(form[:, 3]) > np.abs(form[:, 0])
    form = np.where(swap[:, None], form[:, ::-1], form)
    companion = np.zeros((len(form), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    # All four coefficients vanish where every matrix of the pencil is singular. Any root is right then; here it is
    # zero.
    companion[:, 0] = -form[:, 1:] / np.where(form[:, :1] == 0, 1.0, form[:, :1])
    x = np.linalg.eigvals(companion)
    real = np.abs(x.imag) <= _REAL * np.abs(x)
    circle = np.stack([x.real, np.ones(x.shape)], axis=-1)
    circle = np.where(swap[:, None, None], circle[..., ::-1], circle)
    circle = circle / np.linalg.norm(circle, axis=-1, keepdims=True)
    return np.where(real[..., None], circle, np.nan)
