"""The pose of five matches, by Newton's method.

References
----------
.. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", 2017.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.kernels.compiler import compiled
from quest.robust.kernels.small_algebra import shift, solve_in_place, tangents, turn

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Newton's method doubles the digits at each step: three or four steps come near a root, the others settle on it. A
#: start that has not settled after ten steps circles.
_NEWTON_STEPS = 10
#: Of the starts that settle, one in 300 is farther than this from a root after four steps.
_NOT_NEAR = 0.1
#: A root is found where |n . (t x R m)| is below this value: a thousandth of the noise of the best features.
_ROOT = 1e-7
#: Longest step of the rotation (radians); the direction may move twice as far. The linearization is not valid beyond.
_LONGEST_STEP = 0.3


@compiled
def newton_five(m: Floats, n: Floats, rows: Ints, R: Floats, t: Floats) -> bool:
    r"""Find a pose that five matches obey exactly, by Newton's method from a start.

    Five matches give five equations ``n . (t x R m) = 0`` for the three unknowns of R and the two of t. They are the
    coplanarity of the normals ``R m x n``, which QuEst states in q alone [F17]_; here the vector that is orthogonal to
    the normals is an unknown beside the rotation. The derivatives are those of :mod:`quest.geometry.refine`. There are
    up to ten solutions, and each is reached from some starts: from a random direction and a rotation within 45
    degrees, one start in three to ten reaches the true solution. A start takes a few microseconds, which is cheaper
    than all solutions of one sample by eigenvalues.

    Shapes: ``m, n`` (N, 3), ``rows`` (5,), ``R, t`` (3, 3).

    * Returns: Whether a solution was found that has all five points in front of both cameras. t has the sign of that
      solution.
    """
    A, b = np.empty((5, 5)), np.empty(5)
    for step in range(_NEWTON_STEPS):
        x, y, z, u, v, w = tangents(t)
        worst = 0.0
        for i in range(5):
            m0, m1, m2 = m[rows[i], 0], m[rows[i], 1], m[rows[i], 2]
            n0, n1, n2 = n[rows[i], 0], n[rows[i], 1], n[rows[i], 2]
            a0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
            a1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
            a2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
            c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
            p, cosine = a0 * t[0] + a1 * t[1] + a2 * t[2], a0 * n0 + a1 * n1 + a2 * n2
            A[i, 0], A[i, 1], A[i, 2] = n0 * p - t[0] * cosine, n1 * p - t[1] * cosine, n2 * p - t[2] * cosine
            A[i, 3], A[i, 4] = c0 * x + c1 * y + c2 * z, c0 * u + c1 * v + c2 * w
            b[i] = -(c0 * t[0] + c1 * t[1] + c2 * t[2])
            worst = max(worst, abs(b[i]))
        if step >= 4 and worst > _NOT_NEAR:
            return False
        if worst < _ROOT:
            return _all_in_front(m, n, rows, R, t)
        if not solve_in_place(A, b):
            return False
        angle, sideways = np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2), np.sqrt(b[3] ** 2 + b[4] ** 2)
        factor = min(1.0, _LONGEST_STEP / max(angle, 0.5 * sideways, 1e-300))
        turn(R, factor * b[0], factor * b[1], factor * b[2])
        shift(t, factor * b[3], factor * b[4], x, y, z, u, v, w)
    return False


@compiled
def _all_in_front(m: Floats, n: Floats, rows: Ints, R: Floats, t: Floats) -> bool:
    """Whether all depths have one sign; t is negated where they are all negative."""
    count = 0
    for i in rows:
        a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
        a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
        a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
        p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n[i, 0] * t[0] + n[i, 1] * t[1] + n[i, 2] * t[2]
        cosine = a0 * n[i, 0] + a1 * n[i, 1] + a2 * n[i, 2]
        # Signs of the depths, see quest.geometry.epipolar.depths_from_pose.
        if cosine * s > p and s > cosine * p:
            count += 1
        elif cosine * s < p and s < cosine * p:
            count -= 1
    if count == -len(rows):
        t[0], t[1], t[2] = -t[0], -t[1], -t[2]
    return abs(count) == len(rows)
