"""The linear six-point algorithm for the essential matrix."""

from __future__ import annotations

from itertools import combinations_with_replacement

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

# The ten cubic monomials of x, y, z (letters 0 to 2), and for a pivot a the positions of a^2 (x, y, z).
_CUBICS = tuple(combinations_with_replacement(range(3), 3))
_RATIOS = np.array([[_CUBICS.index(tuple(sorted((a, a, b)))) for b in range(3)] for a in range(3)])


def _nodes() -> tuple[Floats, Floats]:
    """Ten fixed points (10, 3) and the inverse of their monomials; the best of 1000 seeds, with condition number 10."""
    points = np.random.default_rng(332).normal(size=(10, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, np.linalg.inv(points[:, np.array(_CUBICS)].prod(axis=-1))


_NODES, _COEFFICIENTS = _nodes()


def six_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the essential matrix of six matches, linearly.

    ``E = x E1 + y E2 + z E3`` of the null space of the epipolar equations turns the ten cubic constraints of essential
    matrices into ten equations in ten monomials. They are solved as if the monomials were independent unknowns. For
    points on a plane there is more than one solution, and the rotations are wrong.

    J. Philip, "Critical point configurations of the 5-, 6-, 7-, and 8-point algorithms for relative orientation",
    TRITA-MAT-1998-MA-13, KTH, 1998.

    Shapes: ``m, n`` (N, 3), returns (2, 4).

    * ``m, n``: Bearings in camera 1 and camera 2, of any norm, N >= 6; more than six in least squares.
    * Returns: Unit quaternions wxyz, canonical in sign, the twisted pair; the form is that of
      :func:`quest.paper.quest6`.
    """
    m, n, single = as_samples(m, n, at_least=6)
    basis = null_space(m, n, 3)
    # The coefficients of the constraints, without symbolic algebra: interpolated from the values at ten points.
    values = constraints(np.tensordot(_NODES, basis, axes=(1, 1)).swapaxes(0, 1))
    equations = (_COEFFICIENTS @ values).swapaxes(-1, -2)
    monomials = np.linalg.svd(equations)[2][:, -1]
    pivot = np.argmax(np.abs(monomials[:, _RATIOS[np.arange(3), np.arange(3)]]), axis=1)
    xyz = np.take_along_axis(monomials, _RATIOS[pivot], axis=1)
    return finish(rotations_of_essential(np.einsum("bk,bkij->bij", xyz, basis)), m, n, single)
