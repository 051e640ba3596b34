"""Ranking of the candidates of a sample.

A minimal problem has several solutions. The eigenproblem of QuEst adds false ones, since it treats the monomials of one
q as independent. Three criteria rank the candidates:

* Agreement: a candidate of the x/w problem that solves the problems of y/w and z/w too fulfils ``A quartics(q) = 0``.
  The sum of squares of these residuals is, by Cauchy and Binet, the determinant of ``M = sum c_i c_i^T`` with the
  epipolar normals ``c_i = R m_i x n_i``. It vanishes exactly where the smallest eigenvalue of M does. The eigenvector
  of this eigenvalue is t, so no further eigenproblem of QuEst is needed.
* The geometric (Sampson) residual of the sample with that t. The algebraic residual favours candidates of small
  parallax.
* Cheirality: the depths of a true pose are positive. Only cheirality separates the twisted pair.

All functions are vectorized over the samples of a batch and their candidates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.geometry.quaternion import matrix_from_quaternion
from quest.paper.translation import epipolar_normals

Floats = NDArray[np.float64]

# Candidates this close in rotation are one solution, found by several eigenproblems: refinement takes them to the same
# optimum. The two poses of a plane or of a twisted pair are tens of degrees apart.
_SAME_ROTATION_RAD = 0.01

# Below this sine of the parallax noise decides the sign of a depth: 1.4 px at a focal length of 700 px.
_VISIBLE_PARALLAX = 2e-3

# Residuals below a hundredth of a pixel count as equal, so that rounding errors of exact solutions are not ranked.
_RESIDUAL_FLOOR_RAD = 1e-5


def select_candidates(q: Floats, m: Floats, n: Floats, keep: int = 4) -> tuple[Floats, Floats]:
    """Rank the candidates of each sample and return the best few, with their translations.

    Shapes: ``q`` (B, K, 4), ``m, n`` (B, N, 3), returns ``q`` (B, keep, 4), returns ``t`` (B, keep, 3).

    * Returns ``t``: Unit translations with most depths of the sample in front; NaN where q is.
    """
    known = np.isfinite(q[..., 0])
    R = matrix_from_quaternion(np.where(known[..., None], q, [1.0, 0.0, 0.0, 0.0]))
    normals = epipolar_normals(R, m[:, None], n[:, None])
    t = smallest_eigenvectors(normals.swapaxes(-1, -2) @ normals)
    u, v = depths_from_pose(R, t, m, n)
    visible = np.linalg.norm(normals, axis=-1) > _VISIBLE_PARALLAX
    votes = np.where(visible, np.sign(u) + np.sign(v), 0.0)
    sign = np.where(votes.sum(axis=-1) < 0, -1.0, 1.0)[..., None]
    t = sign * t
    behind = (sign * votes < 2) & visible
    rms = np.sqrt((sampson_error(R, t, m, n) ** 2).mean(axis=-1))
    # One match of six behind a camera may be noise, so it raises the cost of a candidate without excluding it. Over 500
    # noisy samples the first of the ranking has half the error that it has with the power 1; the power 4 is not better.
    cost = np.where(known, (rms + _RESIDUAL_FLOOR_RAD) * (1 + behind.sum(axis=-1)) ** 2, np.inf)

    sample = np.arange(len(q))
    chosen = np.empty((len(q), keep), dtype=np.int64)
    found = np.empty((len(q), keep), dtype=bool)
    for k in range(keep):
        best = np.argmin(cost, axis=-1)
        chosen[:, k], found[:, k] = best, np.isfinite(cost[sample, best])
        cosine = np.abs((q @ q[sample, best][..., None])[..., 0])
        cost = np.where(cosine > np.cos(_SAME_ROTATION_RAD / 2), np.inf, cost)
    rows = sample[:, None]
    return np.where(found[..., None], q[rows, chosen], np.nan), np.where(found[..., None], t[rows, chosen], np.nan)


def smallest_eigenvectors(M: Floats) -> Floats:
    """Unit eigenvectors of the smallest eigenvalue, in a tenth of the time of an eigen-decomposition.

    The adjugate of M has the same eigenvectors, and its largest eigenvalue belongs to the smallest one of M. After two
    squarings its largest column is that eigenvector, up to the fourth power of the ratio of the two smallest
    eigenvalues.

    Shapes: ``M`` (..., 3, 3), returns (..., 3).
    """
    a, b, c = M[..., 0], M[..., 1], M[..., 2]
    power = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    for _ in range(2):
        trace = np.trace(power, axis1=-2, axis2=-1)[..., None, None]
        power = power / np.where(trace > 0, trace, 1.0)
        power = power @ power
    largest = np.argmax(np.diagonal(power, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(power, largest[..., None, None], axis=-1)[..., 0]
    norm = np.linalg.norm(column, axis=-1, keepdims=True)
    # Without parallax there is no direction. Any direction is right then, since every translation fits.
    return np.where(norm > 0, column / np.where(norm > 0, norm, 1.0), [0.0, 0.0, 1.0])
