"""The five-point algorithm by the action matrix of its ten cubics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.benchmarks.quest.baselines.essential import (
    as_samples,
    constraints,
    finish,
    null_space,
    rotations_of_essential,
)

Floats = NDArray[np.float64]

# Exponents of the 20 monomials of x, y, z up to degree three: the ten cubics, then the monomials of lower degree.
_CUBICS = [(3, 0, 0), (2, 1, 0), (1, 2, 0), (0, 3, 0), (2, 0, 1), (1, 1, 1), (0, 2, 1), (1, 0, 2), (0, 1, 2), (0, 0, 3)]
_LOWER = [(2, 0, 0), (1, 1, 0), (0, 2, 0), (1, 0, 1), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)]
# x times the ten lower monomials: the first six become cubics (their positions), the others become lower monomials.
_CUBIC_OF = [0, 1, 2, 4, 5, 7]
_LOWER_OF = [0, 1, 3, 6]

# An eigenvalue x is complex where |imaginary| / (1 + |x|) exceeds this bound: rounding separates a double eigenvalue by
# sqrt(1e-16).
_REAL = 1e-7


def _nodes() -> tuple[Floats, Floats]:
    """Twenty fixed points (20, 4) and the inverse of their monomials; the best of 1000 seeds, condition number 26."""
    points = np.random.default_rng(905).normal(size=(20, 4))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    exponents = np.array([(*e, 3 - sum(e)) for e in _CUBICS + _LOWER])
    return points, np.linalg.inv((points[:, None] ** exponents).prod(axis=-1))


_NODES, _COEFFICIENTS = _nodes()

# A fixed rotation of the null space. Without it the basis has the symmetry of the scene: for a motion along x without
# rotation one of the four basis matrices is E itself, and the equations are singular.
_MIXING = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]


def five_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the essential matrices that five matches allow.

    ``E = x E1 + y E2 + z E3 + E4`` is in the null space of the epipolar equations. The ten cubic constraints are solved
    for the ten monomials of degree three, which gives the matrix of multiplication by x on the other ten monomials. Its
    real eigenvectors contain (x, y, z). Points on a plane are solved too; the candidates contain both of their motions.

    H. Stewenius, C. Engels, D. Nister, "Recent developments on direct relative orientation", ISPRS Journal 60, 2006.

    Shapes: ``m, n`` (5, 3), returns (K, 4).

    * Returns: Unit quaternions wxyz, canonical in sign, two for each of at most ten essential matrices; the form is
      that of :func:`quest.paper.quest6`.
    """
    m, n, single = as_samples(m, n, at_least=5, at_most=5)
    basis = np.einsum("kl,blij->bkij", _MIXING, null_space(m, n, 4))
    # The coefficients of the constraints, without symbolic algebra: interpolated from the values at twenty points.
    values = constraints(np.tensordot(_NODES, basis, axes=(1, 1)).swapaxes(0, 1))
    equations = (_COEFFICIENTS @ values).swapaxes(-1, -2)
    leading = equations[..., :10]
    # Singular without translation, see `finish`. No other singular scene is known.
    regular = np.linalg.cond(leading) < 1 / np.finfo(float).eps
    leading = np.where(regular[:, None, None], leading, np.eye(10))
    cubics = -np.linalg.solve(leading, equations[..., 10:])
    action = np.zeros((len(m), 10, 10))
    action[:, :6] = cubics[:, _CUBIC_OF]
    action[:, np.arange(6, 10), _LOWER_OF] = 1.0
    values, vectors = np.linalg.eig(action)
    real = (np.abs(values.imag) <= _REAL * (1 + np.abs(values))) & regular[:, None]
    # (x, y, z, 1) up to a factor; the scale of E is free.
    E = np.einsum("bke,bkij->beij", vectors[:, 6:].real, basis)
    E = np.where(real[..., None, None], E, np.nan)
    return finish(rotations_of_essential(E).reshape(len(m), 20, 4), m, n, single)
