"""The decorators of the compiled loops of the joint fit, and the vectors of three numbers in them.

The vectors are tuples, since a call that fills arrays is slow.
"""

from __future__ import annotations

from pathlib import Path

from quest.jit import compiler_of, inlined
from slam_init.lenses.compiler import FOLDER as LENSES
from slam_init.types.arrays import Floats

#: Sums may be reordered: so a processor makes several lanes of a sum at once. The loops have no powers: numba compiles
#: a power once for all loops of a process, and its last digits would depend on which loop comes first.
compiled = compiler_of(Path(__file__).parent, LENSES, reorders_sums=True)
#: For what only other loops call.
part = compiler_of(Path(__file__).parent, LENSES, reorders_sums=True, part=True)

Vector = tuple[float, float, float]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


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
