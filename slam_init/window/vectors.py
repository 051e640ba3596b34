"""Vectors of three numbers in the compiled loops of the joint fit: tuples, since a call that fills arrays is slow."""

from __future__ import annotations

from quest.jit import inlined
from slam_init.types.arrays import Floats

Vector = tuple[float, float, float]
#: Derivatives by a pose: by its rotation vector, then by its translation.
Six = tuple[float, float, float, float, float, float]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def vector_of(rows: Floats, i: int) -> Vector:
    """Row i of an array (N, 3)."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inlined
def to_view(R: Floats, k: int, X: Vector) -> Vector:
    """``R_k X`` with the rotations R (V, 3, 3)."""
    return (
        R[k, 0, 0] * X[0] + R[k, 0, 1] * X[1] + R[k, 0, 2] * X[2],
        R[k, 1, 0] * X[0] + R[k, 1, 1] * X[1] + R[k, 1, 2] * X[2],
        R[k, 2, 0] * X[0] + R[k, 2, 1] * X[1] + R[k, 2, 2] * X[2],
    )


@inlined
def to_world(R: Floats, k: int, X: Vector) -> Vector:
    """``R_k^T X`` with the rotations R (V, 3, 3)."""
    return (
        R[k, 0, 0] * X[0] + R[k, 1, 0] * X[1] + R[k, 2, 0] * X[2],
        R[k, 0, 1] * X[0] + R[k, 1, 1] * X[1] + R[k, 2, 1] * X[2],
        R[k, 0, 2] * X[0] + R[k, 1, 2] * X[1] + R[k, 2, 2] * X[2],
    )


@inlined
def joint(a: Vector, b: Vector, g0: float, g1: float) -> Vector:
    """``M^T g`` with the rows a and b of M (2, 3)."""
    return a[0] * g0 + b[0] * g1, a[1] * g0 + b[1] * g1, a[2] * g0 + b[2] * g1


@inlined
def by_pose(m: Vector, v: Vector, rho: float) -> Six:
    """A derivative m by the point as one by a pose: ``B^T m = (v x m, rho m)`` (:mod:`slam_init.window.pair_sums`)."""
    return (
        v[1] * m[2] - v[2] * m[1], v[2] * m[0] - v[0] * m[2], v[0] * m[1] - v[1] * m[0],
        rho * m[0], rho * m[1], rho * m[2],
    )  # fmt: skip
