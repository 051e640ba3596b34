"""Linear algebra of three to nine unknowns: tangents, rotations, elimination, eigenvectors; the median."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.jit import compiled, inlined, part

Floats = NDArray[np.float64]

#: Jacobi's method settles in four to eight sweeps; the bound ends the loop on numbers that are not finite.
_SWEEPS = 30


@inlined
def rotated(R: Floats, m: Floats, i: int) -> tuple[float, float, float]:
    """``R m_i``, of any matrix R.

    Shapes: ``R`` (3, 3), ``m`` (N, 3).
    """
    return (
        R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2],
        R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2],
        R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2],
    )


@compiled
def tangents(t: Floats) -> tuple[float, float, float, float, float, float]:
    """Two orthonormal vectors orthogonal to t, as :func:`quest.geometry.epipolar.tangent_basis`.

    Shapes: ``t`` (3,).
    """
    k = 0
    if abs(t[1]) < abs(t[k]):
        k = 1
    if abs(t[2]) < abs(t[k]):
        k = 2
    if k == 0:
        x, y, z = 0.0, t[2], -t[1]
    elif k == 1:
        x, y, z = -t[2], 0.0, t[0]
    else:
        x, y, z = t[1], -t[0], 0.0
    norm = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / norm, y / norm, z / norm
    return x, y, z, t[1] * z - t[2] * y, t[2] * x - t[0] * z, t[0] * y - t[1] * x


@compiled
def turn(R: Floats, w0: float, w1: float, w2: float) -> None:
    """``R <- exp([w]x) R`` in place, through the unit quaternion of w.

    Shapes: ``R`` (3, 3).
    """
    angle = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    half = 0.5 * angle
    # sin(x)/x to second order is exact to machine precision below 1e-4.
    s = np.sin(half) / angle if angle > 1e-4 else 0.5 - half * half / 12
    c, x, y, z = np.cos(half), s * w0, s * w1, s * w2
    for k in range(3):
        a0, a1, a2 = R[0, k], R[1, k], R[2, k]
        # v + 2 c (q x v) + 2 q x (q x v)
        b0, b1, b2 = y * a2 - z * a1, z * a0 - x * a2, x * a1 - y * a0
        R[0, k] = a0 + 2 * (c * b0 + y * b2 - z * b1)
        R[1, k] = a1 + 2 * (c * b1 + z * b0 - x * b2)
        R[2, k] = a2 + 2 * (c * b2 + x * b1 - y * b0)


@part
def shift(t: Floats, b0: float, b1: float) -> None:
    """``t <- t + b0 (x, y, z) + b1 (u, v, w)`` in place, with the tangents of t, scaled back to unit norm.

    Shapes: ``t`` (3,).
    """
    x, y, z, u, v, w = tangents(t)
    t0, t1, t2 = t[0] + b0 * x + b1 * u, t[1] + b0 * y + b1 * v, t[2] + b0 * z + b1 * w
    norm = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
    t[0], t[1], t[2] = t0 / norm, t1 / norm, t2 / norm


@compiled
def solve_in_place(A: Floats, b: Floats) -> bool:
    """Solve ``A x = b`` by Gaussian elimination with row pivots.

    Shapes: ``A`` (N, N), ``b`` (N,).

    * Returns: False where A is singular (a pivot of at most 1e-14); b then has no meaning.
    """
    size = len(b)
    for c in range(size):
        p = c
        for r in range(c + 1, size):
            if abs(A[r, c]) > abs(A[p, c]):
                p = r
        if not abs(A[p, c]) > 1e-14:
            return False
        if p != c:
            for k in range(c, size):
                A[c, k], A[p, k] = A[p, k], A[c, k]
            b[c], b[p] = b[p], b[c]
        inverse = 1.0 / A[c, c]
        for r in range(c + 1, size):
            factor = A[r, c] * inverse
            for k in range(c + 1, size):
                A[r, k] -= factor * A[c, k]
            b[r] -= factor * b[c]
    for c in range(size - 1, -1, -1):
        for k in range(c + 1, size):
            b[c] -= A[c, k] * b[k]
        b[c] /= A[c, c]
    return True


@part
def copy_pose(R: Floats, t: Floats, to_R: Floats, to_t: Floats) -> None:
    """Copy a pose into other arrays.

    Shapes: ``R, t`` (3, 3), ``to_R, to_t`` (3, 3).
    """
    for i in range(3):
        to_t[i] = t[i]
        for j in range(3):
            to_R[i, j] = R[i, j]


@part
def orthonormalize(R: Floats) -> None:
    """Make the rows of a matrix near a rotation orthonormal, in place.

    Shapes: ``R`` (3, 3).
    """
    for i in range(2):
        dot, norm2 = 0.0, 0.0
        for j in range(3):
            dot += i * R[0, j] * R[1, j]
        for j in range(3):
            R[i, j] -= dot * R[0, j]
            norm2 += R[i, j] * R[i, j]
        for j in range(3):
            R[i, j] /= np.sqrt(norm2)
    for j in range(3):
        u, v = (j + 1) % 3, (j + 2) % 3
        R[2, j] = R[0, u] * R[1, v] - R[0, v] * R[1, u]


@compiled
def rotation_of_model(model: Floats) -> Floats:
    """Rotation matrix of a model, as :func:`quest.geometry.quaternion.matrix_from_quaternion`.

    Shapes: ``model`` (7,), returns (3, 3).
    """
    w, x, y, z = model[0], model[1], model[2], model[3]
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


@compiled
def model_of_pose(R: Floats, t: Floats) -> Floats:
    """Row of a pose, see :func:`quest.geometry.quaternion.quaternion_from_matrix`.

    Shapes: ``R, t`` (3, 3), returns (7,).
    """
    model = np.empty(7)
    a, b, c = R[0, 0], R[1, 1], R[2, 2]
    u, v, w = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    d, e, f = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    largest = max(max(a + b + c, a - b - c), max(b - a - c, c - a - b))
    # The largest of the four squared components is the pivot, so that no small number divides.
    if largest == a + b + c:
        model[0], model[1], model[2], model[3] = 1 + largest, u, v, w
    elif largest == a - b - c:
        model[0], model[1], model[2], model[3] = u, 1 + largest, d, e
    elif largest == b - a - c:
        model[0], model[1], model[2], model[3] = v, d, 1 + largest, f
    else:
        model[0], model[1], model[2], model[3] = w, e, f, 1 + largest
    norm = np.sqrt(model[0] ** 2 + model[1] ** 2 + model[2] ** 2 + model[3] ** 2)
    first = 0
    while first < 3 and model[first] == 0:
        first += 1
    if model[first] < 0:
        norm = -norm
    for i in range(4):
        model[i] /= norm
    for i in range(3):
        model[4 + i] = t[i]
    return model


@part
def copy_row(row: Floats, to: Floats) -> None:
    """Copy a row of numbers; an assignment of numba takes long to compile."""
    for i in range(len(row)):
        to[i] = row[i]


@compiled
def eigen_in_place(A: Floats, V: Floats) -> int:
    """Eigenvalues and eigenvectors of a symmetric matrix, by Jacobi's rotations.

    Shapes: ``A`` (N, N), ``V`` (N, N).

    * ``A``: Symmetric; its diagonal is overwritten by the eigenvalues, in no order.
    """
    size = len(A)
    for i in range(size):
        for j in range(size):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        settled = True
        for p in range(size - 1):
            for q in range(p + 1, size):
                # An entry this small changes no eigenvalue beyond the last digit.
                if not A[p, q] * A[p, q] > 1e-34 * abs(A[p, p] * A[q, q]):
                    continue
                settled = False
                ratio = 0.5 * (A[q, q] - A[p, p]) / A[p, q]
                tangent = 1 / (abs(ratio) + np.sqrt(1 + ratio * ratio))
                if ratio < 0:
                    tangent = -tangent
                c = 1 / np.sqrt(1 + tangent * tangent)
                s = c * tangent
                for k in range(size):
                    A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
                for k in range(size):
                    A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
                for k in range(size):
                    V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
        if settled:
            break
    least = 0
    for k in range(1, size):
        if A[k, k] < A[least, least]:
            least = k
    return least


@compiled
def median_in_place(values: Floats) -> float:
    """Median, by quickselect.

    Shapes: ``values`` (N,).

    * Returns: The mean of the two middle values where N is even, as ``numpy.median``.
    """
    count = len(values)
    middle, low, high = count // 2, 0, count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < middle:
            low = i
        if middle < i:
            high = j
    upper: float = values[middle]
    if count % 2 == 1:
        return upper
    # All values before the middle one are at most as large.
    lower: float = values[0]
    for i in range(1, middle):
        lower = max(lower, values[i])
    return 0.5 * (lower + upper)


@compiled
def unit_rows(rays: Floats, unit: Floats) -> bool:
    """Scale rays to unit norm.

    Shapes: ``rays`` (N, 3), ``unit`` (N, 3).

    * Returns: False where a ray is not finite, zero, or so long or short that its square has no exact double.
    """
    for i in range(len(rays)):
        x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
        square = x * x + y * y + z * z
        if not 1e-200 < square < 1e200:
            return False
        norm = np.sqrt(square)
        unit[i, 0], unit[i, 1], unit[i, 2] = x / norm, y / norm, z / norm
    return True
