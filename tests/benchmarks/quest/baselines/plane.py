"""The homography of a plane between calibrated rays, and the rotations of its two motions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.geometry.quaternion import quaternion_from_matrix
from tests.benchmarks.quest.baselines.essential import as_samples, finish

Floats = NDArray[np.float64]

# H, scaled to a middle singular value of 1, is a rotation where the squared singular values differ by less than this.
_ROTATION = 1e-12

# Smallest singular value of H relative to the middle one. For a plane at distances d1 and d2 from the two cameras it is
# about d2 / (d1 + d2); below 1e-9 the second camera practically lies in the plane.
_SINGULAR = 1e-9


def homography(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the two motions that the homography of four or more matches allows.

    ``n x H m = 0`` is solved in least squares over H of unit norm. Then H = R + t k' is decomposed as in
    :func:`quest.geometry.homography.decompose_homography`, here for a batch. For points that lie on no plane the
    rotations are wrong.

    Y. Ma, S. Soatto, J. Kosecka, S. Sastry, "An Invitation to 3-D Vision", 2004, section 5.3.3.

    Shapes: ``m, n`` (N, 3), returns (K, 4).

    * Returns: Unit quaternions wxyz, canonical in sign, in the form of :func:`quest.paper.quest6`.
    """
    m, n, single = as_samples(m, n, at_least=4)
    return finish(_rotations(_fit(m, n)), m, n, single)


def _fit(m: Floats, n: Floats) -> Floats:
    """Homographies (B, 3, 3), scaled to a middle singular value of 1 and a positive determinant; NaN for none."""
    x, y, z = np.moveaxis(n, -1, 0)
    zero = np.zeros(x.shape)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*n.shape[:2], 3, 3)
    rows = (cross[..., None] * m[:, :, None, None, :]).reshape(len(m), -1, 9)
    H = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2][:, -1].reshape(-1, 3, 3)
    _, middle, smallest = np.linalg.svd(H, compute_uv=False).T
    with np.errstate(divide="ignore"):  # a determinant below 1e-308 is zero
        sign = np.sign(np.linalg.det(H))
    # Three rays in a plane give a homography without inverse, which belongs to no motion.
    scale = sign / np.where((smallest > _SINGULAR * middle) & (sign != 0), middle, np.nan)
    return np.asarray(H * scale[:, None, None])


def _rotations(H: Floats) -> Floats:
    """The rotations (B, 2, 4) of homographies as :func:`_fit` scales them; one where H is a rotation itself."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(H).all(axis=(1, 2)))
    H = np.where(known[:, None, None], H, np.eye(3))
    _, s, V = np.linalg.svd(H)
    V = V * np.sign(np.linalg.det(V))[:, None, None]
    v1, v2, v3 = np.moveaxis(V, 1, 0)
    above, below = np.maximum(s[:, 0] ** 2 - 1, 0.0), np.maximum(1 - s[:, 2] ** 2, 0.0)
    is_rotation = above + below < _ROTATION
    spread = np.where(is_rotation, 1.0, above + below)[:, None]
    found = []
    for sign in (1.0, -1.0):
        # H keeps the length of v2 and of u, hence of all vectors that they span: R and H are equal on them.
        u = np.sqrt(below[:, None] / spread) * v1 + sign * np.sqrt(above[:, None] / spread) * v3
        first, second = (H @ v2[..., None])[..., 0], (H @ u[..., None])[..., 0]
        before = np.stack([v2, u, np.cross(v2, u)], axis=-1)
        after = np.stack([first, second, np.cross(first, second)], axis=-1)
        found.append(after @ before.swapaxes(-1, -2))
    R = np.stack(found, axis=1)
    R[is_rotation, 0] = H[is_rotation]
    U, _, Wt = np.linalg.svd(R)
    q = quaternion_from_matrix(U @ Wt)
    q[is_rotation, 1] = np.nan
    q[~known] = np.nan
    return q
