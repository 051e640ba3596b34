"""The compiled loops of bundle adjustment: the equations of poses, points, lens and fields of correlated errors.

The observations are in the order of their landmarks. Each one has a pinhole camera that looks along its measured ray
(:mod:`slam_init.bundle.virtual_cameras`), as one matrix ``L`` (3, 3): rotation and calibration, over the noise. So all
lenses share one residual. With a point ``X`` and the pose ``R, t`` (world_from_cam) of the view ::

    p = R^T (X - t)          q = L p          e = (q_x, q_y) / q_z

The tangent of a pose is that of gtsam, rotation vector w and translation v in the camera frame: ``R exp([w]x)`` and
``t + R v``. With the derivatives ``D = de/dp`` the rows of the Jacobians are ``(D x p, -D)`` for the pose and ``R D``
for the point.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.jit import compiler_of
from slam_init.types.arrays import Floats, Ints

compiled = compiler_of(Path(__file__).parent)
part = compiler_of(Path(__file__).parent, part=True)

#: Error of an observation whose point is not in front of its virtual camera: no step may move a point there.
_BEHIND = 1e12


@compiled
def _project(L: Floats, R: Floats, t: Floats, X: Floats, p: Floats, e: Floats) -> float:
    """The point in the camera and the residual (2,); returns its depth, which is not positive behind the camera."""
    x, y, z = X[0] - t[0], X[1] - t[1], X[2] - t[2]
    for i in range(3):
        p[i] = R[0, i] * x + R[1, i] * y + R[2, i] * z
    depth = L[2, 0] * p[0] + L[2, 1] * p[1] + L[2, 2] * p[2]
    if not depth > 0.0:
        return 0.0
    inverse = 1.0 / depth
    for j in range(2):
        e[j] = (L[j, 0] * p[0] + L[j, 1] * p[1] + L[j, 2] * p[2]) * inverse
    return float(depth)


@part
def _linearize(L: Floats, R: Floats, t: Floats, X: Floats, p: Floats, e: Floats, J: Floats, JX: Floats) -> bool:
    """The residual (2,) and its derivatives by the pose (2, 6) and by the point (2, 3); False behind the camera."""
    depth = _project(L, R, t, X, p, e)
    if depth == 0.0:
        return False
    inverse = 1.0 / depth
    for j in range(2):
        d0 = (L[j, 0] - e[j] * L[2, 0]) * inverse
        d1 = (L[j, 1] - e[j] * L[2, 1]) * inverse
        d2 = (L[j, 2] - e[j] * L[2, 2]) * inverse
        J[j, 0], J[j, 1], J[j, 2] = d1 * p[2] - d2 * p[1], d2 * p[0] - d0 * p[2], d0 * p[1] - d1 * p[0]
        J[j, 3], J[j, 4], J[j, 5] = -d0, -d1, -d2
        for i in range(3):
            JX[j, i] = R[i, 0] * d0 + R[i, 1] * d1 + R[i, 2] * d2
    return True


@part
def _solve_lower(C: Floats, x0: float, x1: float, x2: float) -> tuple[float, float, float]:
    """``C^-1 x`` of a factor: its diagonal, then the elements (1, 0), (2, 0), (2, 1)."""
    y0 = x0 / C[0]
    y1 = (x1 - C[3] * y0) / C[1]
    return y0, y1, (x2 - C[4] * y0 - C[5] * y1) / C[2]


@compiled
def errors_of_points(
    R: Floats, t: Floats, points: Floats, starts: Ints, views: Ints, lenses: Floats, cauchy2: float
) -> Floats:
    """Sums of the squared residuals of each point; of their Cauchy costs where the scale is finite.

    Shapes: ``R`` (K, 3, 3), ``t`` (K, 3), ``points`` (L, 3), ``starts`` (L + 1,), ``views`` (M,),
    ``lenses`` (M, 3, 3), returns (L,).

    * ``starts``: The observations of landmark l are those from ``starts[l]`` up to ``starts[l + 1]``.
    * ``cauchy2``: Squared scale of the kernel, in units of the noise; infinity for least squares.
    * Returns: In units of the noise. A point behind a camera has a huge one.
    """
    p, e, errors = np.empty(3), np.empty(2), np.zeros(len(points))
    for landmark in range(len(points)):
        for m in range(starts[landmark], starts[landmark + 1]):
            k = views[m]
            if _project(lenses[m], R[k], t[k], points[landmark], p, e) == 0.0:
                errors[landmark] += _BEHIND
                continue
            r2 = e[0] * e[0] + e[1] * e[1]
            errors[landmark] += r2 if np.isinf(cauchy2) else cauchy2 * np.log1p(r2 / cauchy2)
    return errors


@compiled
def eliminate_points(
    R: Floats,
    t: Floats,
    points: Floats,
    starts: Ints,
    views: Ints,
    lenses: Floats,
    damping: float,
    cauchy2: float,
    poses_held: bool,
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """The equations of a Gauss-Newton step, prepared for the elimination of the points.

    A point has the equations ``A``, the gradient ``b`` and the coupling ``W`` to the poses. With the Cholesky factor
    ``A = C C^T`` the equations of the poses are ``H - Y^T Y`` with ``Y = C^-1 W`` and the gradient ``g - Y^T z`` with
    ``z = C^-1 b``, and the point follows a step x of the poses by ``-C^-T (z + Y x)``.

    Shapes: returns ``H`` (K, 6, 6), ``g`` (6 K,), ``C`` (L, 6), ``z`` (3 L,), ``Y`` (3 L, 6 K).

    * ``cauchy2``: As for :func:`errors_of_points`; residuals have the weights of the kernel.
    * ``poses_held``: ``H`` and ``g`` are 0 then, and ``Y`` has no columns.
    * Returns ``C``: The diagonal, then the elements (1, 0), (2, 0), (2, 1).
    """
    p, e, J, JX = np.empty(3), np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    A, b = np.empty((3, 3)), np.empty(3)
    blocks, gradient = np.zeros((len(R), 6, 6)), np.zeros(6 * len(R))
    coupling = np.zeros((3 * len(points), 0 if poses_held else 6 * len(R)))
    roots, solved = np.empty((len(points), 6)), np.empty(3 * len(points))
    for landmark in range(len(points)):
        A[:], b[:] = 0.0, 0.0
        row, C = 3 * landmark, roots[landmark]
        for m in range(starts[landmark], starts[landmark + 1]):
            k = views[m]
            if not _linearize(lenses[m], R[k], t[k], points[landmark], p, e, J, JX):
                continue
            first, weight = 6 * k, 1.0 / (1.0 + (e[0] * e[0] + e[1] * e[1]) / cauchy2)
            for i in range(0 if poses_held else 6):
                j0, j1 = weight * J[0, i], weight * J[1, i]
                gradient[first + i] += j0 * e[0] + j1 * e[1]
                for q in range(i + 1):
                    blocks[k, i, q] += j0 * J[0, q] + j1 * J[1, q]
            for i in range(3):
                j0, j1 = weight * JX[0, i], weight * JX[1, i]
                b[i] += j0 * e[0] + j1 * e[1]
                for q in range(i + 1):
                    A[i, q] += j0 * JX[0, q] + j1 * JX[1, q]
                for q in range(0 if poses_held else 6):  # a view may see a point twice
                    coupling[row + i, first + q] += j0 * J[0, q] + j1 * J[1, q]
        C[0] = np.sqrt(A[0, 0] + damping)
        C[3], C[4] = A[1, 0] / C[0], A[2, 0] / C[0]
        C[1] = np.sqrt(A[1, 1] + damping - C[3] * C[3])
        C[5] = (A[2, 1] - C[4] * C[3]) / C[1]
        C[2] = np.sqrt(A[2, 2] + damping - C[4] * C[4] - C[5] * C[5])
        solved[row], solved[row + 1], solved[row + 2] = _solve_lower(C, b[0], b[1], b[2])
        for m in range(starts[landmark], starts[landmark + 1]):
            if poses_held or (m > starts[landmark] and views[m] == views[m - 1]):
                continue
            for q in range(6 * views[m], 6 * views[m] + 6):
                coupling[row, q], coupling[row + 1, q], coupling[row + 2, q] = _solve_lower(
                    C, coupling[row, q], coupling[row + 1, q], coupling[row + 2, q]
                )
    for k in range(len(blocks)):
        for i in range(6):
            for q in range(i):
                blocks[k, q, i] = blocks[k, i, q]
    return blocks, gradient, roots, solved, coupling


@compiled
def derivatives(
    R: Floats, t: Floats, points: Floats, starts: Ints, views: Ints, lenses: Floats
) -> tuple[Floats, Floats]:
    """Derivatives of all residuals by the pose of their view (M, 2, 6) and by their point (M, 2, 3)."""
    p, e, J, JX = np.empty(3), np.empty(2), np.zeros((len(views), 2, 6)), np.zeros((len(views), 2, 3))
    for landmark in range(len(points)):
        for m in range(starts[landmark], starts[landmark + 1]):
            _linearize(lenses[m], R[views[m]], t[views[m]], points[landmark], p, e, J[m], JX[m])
    return J, JX
