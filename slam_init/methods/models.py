"""Fundamental matrices and homographies from batches of small samples, and the errors of matches under them.

All functions take pixels. A batch of B samples of n matches is one array (B, n, 2); its models are one array (B, 3, 3).

References
----------
.. [1] R. Hartley, "In defense of the eight-point algorithm", PAMI 1997.
.. [2] R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, sections 4.1 (homographies), 11.3 (F), 11.4 (errors).
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats, Ints


def homogeneous(pixels: Floats) -> Floats:
    """Append a last coordinate of one: ``pixels`` (..., n, 2), returns (..., n, 3)."""
    return np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], axis=-1)


def fundamentals(pixels1: Floats, pixels2: Floats, samples: Ints) -> Floats:
    """Compute the fundamental matrices ``x2 . F x1 = 0`` of rank two of samples of n >= 8 matches [1]_.

    The pixels are normalized by all matches.

    Shapes: ``pixels1, pixels2`` (N, 2), ``samples`` (B, n), returns (B, 3, 3).
    """
    (T1, points1), (T2, points2) = _normalized(pixels1), _normalized(pixels2)
    x1, x2 = homogeneous(points1[samples]), homogeneous(points2[samples])
    rows = (x2[..., :, None] * x1[..., None, :]).reshape(*x1.shape[:-1], 9)
    U, S, Vt = np.linalg.svd(_null_matrices(rows))
    S[:, 2] = 0
    return np.asarray(T2.T @ ((U * S[:, None, :]) @ Vt) @ T1)


def homographies(pixels1: Floats, pixels2: Floats, samples: Ints) -> Floats:
    """Compute the homographies ``x2 ~ H x1`` of samples of n >= 4 matches by the direct linear transformation [2]_.

    Shapes: as those of :func:`fundamentals`.
    """
    (T1, points1), (T2, points2) = _normalized(pixels1), _normalized(pixels2)
    x1, u, v = homogeneous(points1[samples]), points2[samples][..., :1], points2[samples][..., 1:]
    zero = np.zeros_like(x1)
    rows = np.concatenate(
        [np.concatenate([zero, -x1, v * x1], axis=-1), np.concatenate([x1, zero, -u * x1], axis=-1)], axis=-2
    )
    return np.asarray(np.linalg.inv(T2) @ _null_matrices(rows) @ T1)


def _normalized(pixels: Floats) -> tuple[Floats, Floats]:
    """Give pixels mean zero and mean absolute coordinates of one on each axis: the transformation, and the points.

    ORB-SLAM and stella_vslam use it. Hartley [1]_ scales both axes equally, to a mean distance of sqrt(2). If the
    pixels lie on a line along one axis, the scale of the other axis is not changed.
    """
    mean = pixels.mean(axis=0)
    spread = np.abs(pixels - mean).mean(axis=0)
    scale = 1 / np.where(spread > 0, spread, 1.0)
    transform = np.diag([*scale, 1.0])
    transform[:2, 2] = -scale * mean
    return transform, pixels * scale + transform[:2, 2]


def _null_matrices(rows: Floats) -> Floats:
    """Return the matrices (B, 3, 3) of norm one whose products with the rows (B, k, 9) are smallest."""
    # The eigenvectors of the normal matrix are much faster to compute than a full SVD. Squaring the rows only loses
    # digits far below the noise of a pixel, since the rows are normalized.
    return np.asarray(np.linalg.eigh(rows.swapaxes(-1, -2) @ rows)[1][..., 0].reshape(-1, 3, 3))


def transfer_errors(H: Floats, pixels1: Floats, pixels2: Floats) -> tuple[Floats, Floats]:
    """Compute the squared transfer errors of matches under homographies.

    Shapes: ``H`` (B, 3, 3), ``pixels1, pixels2`` (N, 2), returns ``in2`` (B, N), returns ``in1`` (B, N).

    * Returns ``in2``: Squared distance between x2 and H x1 in the second image, in squared pixels.
    """
    with np.errstate(all="ignore"):  # the error of a singular H, or of a point at infinity, is infinite or NaN
        # The adjugate matrix is the inverse up to scale, and exists for singular matrices too.
        adjugate = np.cross(H[..., [1, 2, 0], :], H[..., [2, 0, 1], :]).swapaxes(-1, -2)
        return _squared_distance(H, pixels1, pixels2), _squared_distance(adjugate, pixels2, pixels1)


def _squared_distance(H: Floats, source: Floats, target: Floats) -> Floats:
    """Return the squared distances (B, N) between H source and target."""
    x, y, w = np.moveaxis(H @ homogeneous(source).T, -2, 0)
    return np.asarray((x / w - target[:, 0]) ** 2 + (y / w - target[:, 1]) ** 2)


def epipolar_errors(F: Floats, pixels1: Floats, pixels2: Floats) -> tuple[Floats, Floats]:
    """Compute the squared distances of matches from their epipolar lines.

    Shapes: ``F`` (B, 3, 3), ``pixels1, pixels2`` (N, 2), returns ``in2`` (B, N), returns ``in1`` (B, N).

    * Returns ``in2``: Squared distance between x2 and the line F x1, in squared pixels.
    """
    product, lines2, lines1 = _epipolar(F, pixels1, pixels2)
    with np.errstate(all="ignore"):  # 0/0 at the epipole
        return product**2 / lines2, product**2 / lines1


def sampson_errors(F: Floats, pixels1: Floats, pixels2: Floats) -> Floats:
    """Compute the squared Sampson distances of matches [2]_.

    Shapes: ``F`` (B, 3, 3), ``pixels1, pixels2`` (N, 2), returns (B, N).
    """
    product, lines2, lines1 = _epipolar(F, pixels1, pixels2)
    with np.errstate(all="ignore"):  # 0/0 where both are epipoles
        return np.asarray(product**2 / (lines2 + lines1))


def _epipolar(F: Floats, pixels1: Floats, pixels2: Floats) -> tuple[Floats, Floats, Floats]:
    """Return ``x2 . F x1`` and the squared norms of the normals of F x1 and of F^T x2, each (B, N)."""
    x1, x2 = homogeneous(pixels1), homogeneous(pixels2)
    products = (x2[:, :, None] * x1[:, None, :]).reshape(len(x1), 9)
    in2, in1 = F[..., :2, :] @ x1.T, F.swapaxes(-1, -2)[..., :2, :] @ x2.T
    product = F.reshape(*F.shape[:-2], 9) @ products.T
    return product, np.sum(in2**2, axis=-2), np.sum(in1**2, axis=-2)
