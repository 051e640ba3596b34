"""The compiled loops of bundle adjustment: the equations of poses and points, and the points alone.

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

from quest.robust.kernels.compiler import compiler_of
from slam_init.types.arrays import Floats, Ints

compiled = compiler_of(Path(__file__).parent)

#: Error of an observation whose point is not in front of its virtual camera: no step may move a point there.
_BEHIND = 1e12


@compiled
def _project(L: Floats, R: Floats, t: Floats, X: Floats, p: Floats, D: Floats, e: Floats) -> bool:
    """The point in the camera, the residual (2,) and its derivatives (2, 3); False for a point behind the camera."""
    x, y, z = X[0] - t[0], X[1] - t[1], X[2] - t[2]
    for i in range(3):
        p[i] = R[0, i] * x + R[1, i] * y + R[2, i] * z
    depth = L[2, 0] * p[0] + L[2, 1] * p[1] + L[2, 2] * p[2]
    if not depth > 0.0:
        return False
    inverse = 1.0 / depth
    for j in range(2):
        e[j] = (L[j, 0] * p[0] + L[j, 1] * p[1] + L[j, 2] * p[2]) * inverse
        for i in range(3):
            D[j, i] = (L[j, i] - e[j] * L[2, i]) * inverse
    return True


@compiled
def squared_error(R: Floats, t: Floats, points: Floats, starts: Ints, views: Ints, lenses: Floats) -> float:
    """Sum of the squared residuals.

    Shapes: ``R, t`` (K, 3, 3), ``points`` (L, 3), ``starts`` (L + 1,), ``views`` (M,), ``lenses`` (M, 3, 3).

    * ``starts``: The observations of landmark l are those from ``starts[l]`` up to ``starts[l + 1]``.
    * Returns: In units of the noise. A point behind a camera makes it huge.
    """
    p, D, e = np.empty(3), np.empty((2, 3)), np.empty(2)
    total = 0.0
    for landmark in range(len(points)):
        for m in range(starts[landmark], starts[landmark + 1]):
            k = views[m]
            if _project(lenses[m], R[k], t[k], points[landmark], p, D, e):
                total += e[0] * e[0] + e[1] * e[1]
            else:
                total += _BEHIND
    return total


@compiled
def eliminate_points(
    R: Floats,
    t: Floats,
    points: Floats,
    starts: Ints,
    views: Ints,
    lenses: Floats,
    damping: float,
    blocks: Floats,
    gradient: Floats,
    roots: Floats,
    solved: Floats,
    coupling: Floats,
) -> None:
    """The equations of a Gauss-Newton step, prepared for the elimination of the points.

    A point has the equations ``A``, the gradient ``b`` and the coupling ``W`` to the poses. With the Cholesky factor
    ``A = C C^T`` the equations of the poses are ``H - Y^T Y`` with ``Y = C^-1 W`` and the gradient ``g - Y^T z`` with
    ``z = C^-1 b``, and the point follows a step x of the poses by ``-C^-T (z + Y x)``.

    Shapes: ``blocks`` (K, 6, 6), ``roots`` (L, 6).

    * ``roots``: Receives C of each point: its diagonal, then the elements (1, 0), (2, 0), (2, 1).
    """
    p, D, e = np.empty(3), np.empty((2, 3)), np.empty(2)
    J, JX = np.empty((2, 6)), np.empty((2, 3))
    A, b = np.empty((3, 3)), np.empty(3)
    blocks[:], gradient[:], coupling[:] = 0.0, 0.0, 0.0
    for landmark in range(len(points)):
        A[:], b[:] = 0.0, 0.0
        row = 3 * landmark
        for m in range(starts[landmark], starts[landmark + 1]):
            k = views[m]
            if not _project(lenses[m], R[k], t[k], points[landmark], p, D, e):
                continue
            first = 6 * k
            for j in range(2):
                J[j, 0] = D[j, 1] * p[2] - D[j, 2] * p[1]
                J[j, 1] = D[j, 2] * p[0] - D[j, 0] * p[2]
                J[j, 2] = D[j, 0] * p[1] - D[j, 1] * p[0]
                for i in range(3):
                    J[j, 3 + i] = -D[j, i]
                    JX[j, i] = R[k, i, 0] * D[j, 0] + R[k, i, 1] * D[j, 1] + R[k, i, 2] * D[j, 2]
            for i in range(6):
                gradient[first + i] += J[0, i] * e[0] + J[1, i] * e[1]
                for q in range(i + 1):
                    blocks[k, i, q] += J[0, i] * J[0, q] + J[1, i] * J[1, q]
            for i in range(3):
                b[i] += JX[0, i] * e[0] + JX[1, i] * e[1]
                for q in range(i + 1):
                    A[i, q] += JX[0, i] * JX[0, q] + JX[1, i] * JX[1, q]
                for q in range(6):  # a view may see a point twice
                    coupling[row + i, first + q] += JX[0, i] * J[0, q] + JX[1, i] * J[1, q]
        c00 = np.sqrt(A[0, 0] + damping)
        c10, c20 = A[1, 0] / c00, A[2, 0] / c00
        c11 = np.sqrt(A[1, 1] + damping - c10 * c10)
        c21 = (A[2, 1] - c20 * c10) / c11
        c22 = np.sqrt(A[2, 2] + damping - c20 * c20 - c21 * c21)
        roots[landmark, 0], roots[landmark, 1], roots[landmark, 2] = c00, c11, c22
        roots[landmark, 3], roots[landmark, 4], roots[landmark, 5] = c10, c20, c21
        solved[row] = b[0] / c00
        solved[row + 1] = (b[1] - c10 * solved[row]) / c11
        solved[row + 2] = (b[2] - c20 * solved[row] - c21 * solved[row + 1]) / c22
        for m in range(starts[landmark], starts[landmark + 1]):
            if m > starts[landmark] and views[m] == views[m - 1]:
                continue
            for q in range(6 * views[m], 6 * views[m] + 6):
                y0 = coupling[row, q] / c00
                y1 = (coupling[row + 1, q] - c10 * y0) / c11
                coupling[row, q], coupling[row + 1, q] = y0, y1
                coupling[row + 2, q] = (coupling[row + 2, q] - c20 * y0 - c21 * y1) / c22
    for k in range(len(blocks)):
        for i in range(6):
            for q in range(i):
                blocks[k, q, i] = blocks[k, i, q]


@compiled
def couple_shared_errors(
    R: Floats,
    t: Floats,
    points: Floats,
    starts: Ints,
    views: Ints,
    lenses: Floats,
    roots: Floats,
    by_lens: Floats,
    places: Floats,
    residuals: Floats,
    of_points: Floats,
    of_poses: Floats,
    own: Floats,
    gradient: Floats,
    solved: Floats,
    scores: Floats,
) -> None:
    """The part of errors that observations share in the equations: of the lens, and of a smooth field in each view.

    A field moves a pixel along both coordinates, as the principal point does, by the sum of six polynomials each. All
    derivatives and residuals are over the noise.

    Shapes: ``roots`` (L, 6), ``by_lens`` (M, 2, 4), ``places`` (M, 6), ``residuals`` (M, 2).

    * ``roots``: Of :func:`eliminate_points`.
    * ``by_lens``: Columns 1 and 2 are those of the principal point.
    * ``of_points``: Receives ``C^-1 V`` (L, 3, 4 + 12 K) with the coupling V of the points to lens and fields.
    * ``of_poses, own``: Receive the products of a view (K, 6, 16) with lens and field, and of both with both
      (K, 16, 16).
    * ``gradient``: Receives that by lens and fields.
    * ``solved, scores``: Receive ``C^-1 b`` (L, 3) and the part of each landmark in the gradient of the poses
      (L, 6 K), before the elimination.
    """
    p, D, e = np.empty(3), np.empty((2, 3)), np.empty(2)
    J, JX, S = np.empty((2, 6)), np.empty((2, 3)), np.empty((2, 16))
    of_points[:], of_poses[:], own[:], gradient[:], solved[:], scores[:] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for landmark in range(len(points)):
        V = of_points[landmark]
        for m in range(starts[landmark], starts[landmark + 1]):
            k = views[m]
            if not _project(lenses[m], R[k], t[k], points[landmark], p, D, e):
                continue
            for j in range(2):
                J[j, 0] = D[j, 1] * p[2] - D[j, 2] * p[1]
                J[j, 1] = D[j, 2] * p[0] - D[j, 0] * p[2]
                J[j, 2] = D[j, 0] * p[1] - D[j, 1] * p[0]
                for i in range(3):
                    J[j, 3 + i] = -D[j, i]
                    JX[j, i] = R[k, i, 0] * D[j, 0] + R[k, i, 1] * D[j, 1] + R[k, i, 2] * D[j, 2]
                for i in range(4):
                    S[j, i] = by_lens[m, j, i]
                for i in range(6):
                    S[j, 4 + i] = by_lens[m, j, 1] * places[m, i]
                    S[j, 10 + i] = by_lens[m, j, 2] * places[m, i]
            field = 4 + 12 * k
            e0, e1 = residuals[m, 0], residuals[m, 1]
            for q in range(16):
                column = q if q < 4 else field + q - 4
                gradient[column] += S[0, q] * e0 + S[1, q] * e1
                for i in range(3):
                    V[i, column] += JX[0, i] * S[0, q] + JX[1, i] * S[1, q]
                for i in range(6):
                    of_poses[k, i, q] += J[0, i] * S[0, q] + J[1, i] * S[1, q]
                for i in range(16):
                    own[k, i, q] += S[0, i] * S[0, q] + S[1, i] * S[1, q]
            for i in range(3):
                solved[landmark, i] += JX[0, i] * e0 + JX[1, i] * e1
            for i in range(6):
                scores[landmark, 6 * k + i] += J[0, i] * e0 + J[1, i] * e1
        c00, c11, c22, c10, c20, c21 = roots[landmark]
        for q in range(V.shape[1]):
            V[0, q] /= c00
            V[1, q] = (V[1, q] - c10 * V[0, q]) / c11
            V[2, q] = (V[2, q] - c20 * V[0, q] - c21 * V[1, q]) / c22
        z = solved[landmark]
        z[0] /= c00
        z[1] = (z[1] - c10 * z[0]) / c11
        z[2] = (z[2] - c20 * z[0] - c21 * z[1]) / c22


@compiled
def leverage_of_pairs(
    R: Floats,
    t: Floats,
    points: Floats,
    starts: Ints,
    views: Ints,
    lenses: Floats,
    covariance: Floats,
    leverage: Floats,
) -> None:
    """Share of each landmark with two views in its own residual.

    Four coordinates and three unknowns leave one residual, along ``u`` across the derivatives by the point. Its
    derivative by the poses is ``g``, and the errors of the poses move it by ``g^T S g`` in units of the noise.

    Shapes: ``covariance`` (6 K, 6 K), ``leverage`` (L,).

    * ``leverage``: Receives the shares; 0 for landmarks with another number of views.
    """
    p, D, e = np.empty(3), np.empty((2, 3)), np.empty(2)
    JX, J, u, g, at = np.empty((4, 3)), np.empty((4, 6)), np.empty(4), np.empty(12), np.empty(12, np.int64)
    for landmark in range(len(points)):
        first = starts[landmark]
        leverage[landmark] = 0.0
        if starts[landmark + 1] - first != 2:
            continue
        for m in range(2):
            k = views[first + m]
            _project(lenses[first + m], R[k], t[k], points[landmark], p, D, e)
            for j in range(2):
                row = 2 * m + j
                J[row, 0] = D[j, 1] * p[2] - D[j, 2] * p[1]
                J[row, 1] = D[j, 2] * p[0] - D[j, 0] * p[2]
                J[row, 2] = D[j, 0] * p[1] - D[j, 1] * p[0]
                for i in range(3):
                    J[row, 3 + i] = -D[j, i]
                    JX[row, i] = R[k, i, 0] * D[j, 0] + R[k, i, 1] * D[j, 1] + R[k, i, 2] * D[j, 2]
            for i in range(6):
                at[6 * m + i] = 6 * k + i
        length = 0.0
        for row in range(4):  # the cofactors of a fourth column
            a, b, c = JX[(row + 1) % 4], JX[(row + 2) % 4], JX[(row + 3) % 4]
            u[row] = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            u[row] += a[2] * (b[0] * c[1] - b[1] * c[0])
            u[row] *= 1.0 - 2.0 * (row % 2)
            length += u[row] * u[row]
        if length == 0.0:
            continue
        for i in range(6):
            g[i] = u[0] * J[0, i] + u[1] * J[1, i]
            g[6 + i] = u[2] * J[2, i] + u[3] * J[3, i]
        for i in range(12):
            for j in range(12):
                leverage[landmark] += g[i] * covariance[at[i], at[j]] * g[j] / length


@compiled
def spread_to_points(
    roots: Floats,
    followed: Floats,
    newest: Floats,
    R: Floats,
    seen: Floats,
    shared: int,
    points: Floats,
    in_newest: Floats,
    by_noise: Floats,
) -> None:
    """Covariances of the points from independent causes of unit variance.

    Shapes: ``roots`` (L, 6), ``followed`` (L, 3, T), ``newest`` (6, T), ``R`` (3, 3), ``seen`` (L, 3).

    * ``followed``: A point moves by ``-C^-T`` times a column for its cause. Overwritten.
    * ``newest``: Rotation vector and translation of the newest camera for each cause.
    * ``R``: Its world_from_cam.
    * ``seen``: The points in the newest camera.
    * ``shared``: The causes from here on are errors that tracks share.
    * ``points, in_newest, by_noise``: Receive the covariances (L, 3, 3) in the world, in the newest camera, and there
      by the noise of single tracks alone.
    """
    own, x, y = np.empty((3, 3)), np.empty(3), np.empty(3)
    for landmark in range(len(roots)):
        c00, c11, c22, c10, c20, c21 = roots[landmark]
        F, s = followed[landmark], seen[landmark]
        # The rays: the columns of C^-T, with the sign of the causes.
        own[:] = 0.0
        own[0, 0], own[1, 1], own[2, 2] = 1.0, 1.0, 1.0
        for i in range(3):
            for j in range(3):
                points[landmark, i, j] = in_newest[landmark, i, j] = 0.0
        causes = F.shape[1]
        for column in range(causes + 3):
            rays = column >= causes
            for i in range(3):
                x[i] = own[i, column - causes] if rays else F[i, column]
            x[2] = -x[2] / c22
            x[1] = (-x[1] - c21 * x[2]) / c11
            x[0] = (-x[0] - c10 * x[1] - c20 * x[2]) / c00
            for i in range(3):
                y[i] = R[0, i] * x[0] + R[1, i] * x[1] + R[2, i] * x[2]
            if not rays:
                w0, w1, w2 = newest[0, column], newest[1, column], newest[2, column]
                y[0] += s[1] * w2 - s[2] * w1 - newest[3, column]
                y[1] += s[2] * w0 - s[0] * w2 - newest[4, column]
                y[2] += s[0] * w1 - s[1] * w0 - newest[5, column]
            if column == shared:
                by_noise[landmark] = in_newest[landmark]
            for i in range(3):
                for j in range(3):
                    points[landmark, i, j] += x[i] * x[j]
                    in_newest[landmark, i, j] += y[i] * y[j]
                    if rays:
                        by_noise[landmark, i, j] += y[i] * y[j]


@compiled
def fit_points_to_rays(
    points: Floats,
    starts: Ints,
    views: Ints,
    centres: Floats,
    rays: Floats,
    scale_rad: float,
    share: float,
    steps: int,
) -> None:
    """Fit points to their rays with a Cauchy kernel, each one for itself.

    The residual is the part of the offset from the camera that is across the ray, as an angle. Its derivative is the
    projector over the distance.

    Shapes: ``points`` (L, 3), ``starts, views`` (L + 1,), ``centres`` (K, 3), ``rays`` (M, 3).

    * ``points``: The start; overwritten by the result. A point that a step would move behind a camera stays where it
      is.
    * ``share``: Damping, as a share of the trace of the equations of a point.
    """
    scale2 = scale_rad * scale_rad
    A, b, d, moved = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for landmark in range(len(points)):
        X = points[landmark]
        for _ in range(steps):
            A[:], b[:] = 0.0, 0.0
            for m in range(starts[landmark], starts[landmark + 1]):
                ray, centre = rays[m], centres[views[m]]
                for i in range(3):
                    d[i] = X[i] - centre[i]
                distance = max(np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), 1e-300)
                along = d[0] * ray[0] + d[1] * ray[1] + d[2] * ray[2]
                r2 = 0.0
                for i in range(3):
                    d[i] = (d[i] - along * ray[i]) / distance
                    r2 += d[i] * d[i]
                weight = 1.0 / ((1.0 + r2 / scale2) * distance * distance)
                if not np.isfinite(weight):
                    continue
                for i in range(3):
                    b[i] += weight * distance * d[i]
                    for q in range(i + 1):
                        A[i, q] -= weight * ray[i] * ray[q]
                    A[i, i] += weight
            extra = share * (A[0, 0] + A[1, 1] + A[2, 2]) + 1e-300
            c00 = np.sqrt(A[0, 0] + extra)
            c10, c20 = A[1, 0] / c00, A[2, 0] / c00
            c11 = np.sqrt(A[1, 1] + extra - c10 * c10)
            c21 = (A[2, 1] - c20 * c10) / c11
            c22 = np.sqrt(A[2, 2] + extra - c20 * c20 - c21 * c21)
            z0 = b[0] / c00
            z1 = (b[1] - c10 * z0) / c11
            x2 = (b[2] - c20 * z0 - c21 * z1) / (c22 * c22)
            x1 = (z1 - c21 * x2) / c11
            x0 = (z0 - c10 * x1 - c20 * x2) / c00
            moved[0], moved[1], moved[2] = X[0] - x0, X[1] - x1, X[2] - x2
            stays = not (np.isfinite(moved[0]) and np.isfinite(moved[1]) and np.isfinite(moved[2]))
            for m in range(starts[landmark], starts[landmark + 1]):
                ray, centre = rays[m], centres[views[m]]
                before, after = 0.0, 0.0
                for i in range(3):
                    before += (X[i] - centre[i]) * ray[i]
                    after += (moved[i] - centre[i]) * ray[i]
                if before > 0.0 and not after > 0.0:
                    stays = True
            if stays:
                break  # the same step would be refused again
            for i in range(3):
                X[i] = moved[i]
