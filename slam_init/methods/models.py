"""Fundamental matrices and homographies from small samples, many at a time, and how far matches are from them.

All functions take pixels. A batch of B samples of n matches is one array (B, n, 2), its models (B, 3, 3).

References
----------
.. [1] R. Hartley, "In defense of the eight-point algorithm", PAMI 1997.
.. [2] R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, sections 4.1 (homographies), 11.3 (F), 11.4 (errors).
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats

__all__ = [
    "epipolar_errors",
    "fundamental_eight_point",
    "homogeneous",
    "homography_dlt",
    "normalize",
    "normalizing_transform",
    "sampson_errors",
    "transfer_errors",
]


def homogeneous(pixels: Floats) -> Floats:
    """(..., n, 2) -> (..., n, 3) with a last coordinate of one."""
    return np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], axis=-1)


def normalizing_transform(pixels: Floats) -> Floats:
    """(3, 3) that brings pixels (N, 2) to mean zero and mean absolute coordinates of one, each axis for itself.

    Hartley [1]_ scales both axes alike, to a mean distance of sqrt(2); ORB-SLAM and stella_vslam do this. Points on a
    line along an axis keep their scale there.
    """
    mean = pixels.mean(axis=0)
    spread = np.abs(pixels - mean).mean(axis=0)
    sx, sy = 1 / np.where(spread > 0, spread, 1.0)
    return np.array([[sx, 0, -sx * mean[0]], [0, sy, -sy * mean[1]], [0, 0, 1.0]])


def normalize(transform: Floats, pixels: Floats) -> Floats:
    """Pixels (N, 2) under such a transform (3, 3)."""
    return np.asarray(pixels * np.diag(transform)[:2] + transform[:2, 2])


def fundamental_eight_point(points1: Floats, points2: Floats) -> Floats:
    """Fundamental matrices ``x2 . F x1 = 0`` of rank two from n >= 8 matches each [1]_.

    Parameters
    ----------
    points1, points2 : (B, n, 2) float
        Best normalized, see :func:`normalizing_transform`.

    Returns
    -------
    (B, 3, 3) float
    """
    x1, x2 = homogeneous(points1), homogeneous(points2)
    rows = (x2[..., :, None] * x1[..., None, :]).reshape(*x1.shape[:-1], 9)
    U, S, Vt = np.linalg.svd(_null_vectors(rows).reshape(-1, 3, 3))
    S[:, 2] = 0
    return np.asarray((U * S[:, None, :]) @ Vt)


def homography_dlt(points1: Floats, points2: Floats) -> Floats:
    """Homographies ``x2 ~ H x1`` from n >= 4 matches each, by the direct linear transformation.

    Parameters and result as for :func:`fundamental_eight_point`.
    """
    x1, zero = homogeneous(points1), np.zeros((*points1.shape[:-1], 3))
    u, v = points2[..., :1], points2[..., 1:]
    rows = np.concatenate(
        [np.concatenate([zero, -x1, v * x1], axis=-1), np.concatenate([x1, zero, -u * x1], axis=-1)], axis=-2
    )
    return _null_vectors(rows).reshape(-1, 3, 3)


def _null_vectors(rows: Floats) -> Floats:
    """Unit vectors (B, 9) that rows (B, k, 9) take nearest to zero."""
    # Of the normal matrix: faster than a full SVD by far. The digits that squaring costs are far below the noise of a
    # pixel, as the rows are normalized.
    return np.asarray(np.linalg.eigh(rows.swapaxes(-1, -2) @ rows)[1][..., 0])


def transfer_errors(H: Floats, pixels1: Floats, pixels2: Floats) -> tuple[Floats, Floats]:
    """Squared distances (B, N) of x2 from H x1 in the second image, and of x1 from H^-1 x2 in the first."""
    with np.errstate(all="ignore"):  # a singular H, or a point sent to infinity, is infinitely far or NaN
        inverse = _adjugate(H)
        return _squared_distance(H, pixels1, pixels2), _squared_distance(inverse, pixels2, pixels1)


def _squared_distance(H: Floats, source: Floats, target: Floats) -> Floats:
    x, y, w = np.moveaxis(H @ homogeneous(source).T, -2, 0)
    return np.asarray((x / w - target[:, 0]) ** 2 + (y / w - target[:, 1]) ** 2)


def _adjugate(H: Floats) -> Floats:
    """The inverses up to scale, also where there are none."""
    rows = np.cross(H[..., [1, 2, 0], :], H[..., [2, 0, 1], :])
    return np.asarray(rows.swapaxes(-1, -2))


def epipolar_errors(F: Floats, pixels1: Floats, pixels2: Floats) -> tuple[Floats, Floats]:
    """Squared distances (B, N) of x2 from the line F x1, and of x1 from the line F^T x2."""
    product, lines2, lines1 = _epipolar(F, pixels1, pixels2)
    with np.errstate(all="ignore"):  # 0/0 at the epipole
        return product**2 / lines2, product**2 / lines1


def sampson_errors(F: Floats, pixels1: Floats, pixels2: Floats) -> Floats:
    """Squared Sampson distances (B, N) in pixels^2 [2]_."""
    product, lines2, lines1 = _epipolar(F, pixels1, pixels2)
    with np.errstate(all="ignore"):  # 0/0 where both are epipoles
        return np.asarray(product**2 / (lines2 + lines1))


def _epipolar(F: Floats, pixels1: Floats, pixels2: Floats) -> tuple[Floats, Floats, Floats]:
    """``x2 . F x1`` and the squared norms of the normals of F x1 and of F^T x2, each (B, N)."""
    x1, x2 = homogeneous(pixels1), homogeneous(pixels2)
    products = (x2[:, :, None] * x1[:, None, :]).reshape(len(x1), 9)
    in2, in1 = F[..., :2, :] @ x1.T, F.swapaxes(-1, -2)[..., :2, :] @ x2.T
    product = F.reshape(*F.shape[:-2], 9) @ products.T
    return product, np.sum(in2**2, axis=-2), np.sum(in1**2, axis=-2)
