"""Sums over the tracks of an anchor and a view, from which the equations of the poses are made.

Let ``M`` (2, 3) be the derivatives of a residual by the point in the axes of the anchor, in proportion to what the
residual weighs, and ``v = d - rho t_a`` (:mod:`slam_init.window.kernels`). The derivatives by the pose of the view,
turned into the axes of the anchor, are ``M B`` with ``B = [-[v]x, rho I]``, and those by the pose of the anchor are
``-M B``. ``B`` is the same in all views of a track. So an observation adds ``B^T M^T M B`` to one sum of its anchor and
view, in place of blocks for the view, for the anchor and for both. The sums are turned into the view once.

On a plane the distance of a track follows the plane and the pose of its anchor: ``M s c^T`` joins, with ``s`` the
derivative of the point by the inverse distance, and ``c`` those of the inverse distance by the pose and by the plane.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.window.compiler import compiled


@compiled
def relative_poses(R: Floats, t: Floats, turn: Floats, shift: Floats) -> None:
    """The rotations ``R_k R_a^T``, and the derivatives of points by their inverse distances.

    Shapes: ``R, t`` (V, 3, 3), ``turn`` (V, V, 9), ``shift`` (V, V, 3).
    """
    V = len(R)
    for a in range(V):
        for k in range(V):
            for p in range(3):
                for q in range(3):
                    element = R[k, p, 0] * R[a, q, 0] + R[k, p, 1] * R[a, q, 1] + R[k, p, 2] * R[a, q, 2]
                    turn[a, k, 3 * p + q] = element
            for q in range(3):
                moved = turn[a, k, q] * t[k, 0] + turn[a, k, 3 + q] * t[k, 1] + turn[a, k, 6 + q] * t[k, 2]
                shift[a, k, q] = moved - t[a, q]


@compiled
def pose_products(
    m00: float,
    m01: float,
    m02: float,
    m11: float,
    m12: float,
    m22: float,
    v0: float,
    v1: float,
    v2: float,
    r: float,
) -> tuple[float, ...]:
    """``B^T M B`` of an observation. Numbers in place of arrays: a call with an array takes as long as the arithmetic.

    * Returns: Rotation by rotation (lower half), rotation by translation (row by row), translation by translation
      (lower half).
    """
    # Rows of N: v x rows of M.
    n00, n01, n02 = v1 * m02 - v2 * m01, v2 * m00 - v0 * m02, v0 * m01 - v1 * m00
    n10, n11, n12 = v1 * m12 - v2 * m11, v2 * m01 - v0 * m12, v0 * m11 - v1 * m01
    n20, n21, n22 = v1 * m22 - v2 * m12, v2 * m02 - v0 * m22, v0 * m12 - v1 * m02
    s = r * r
    return (
        v1 * n20 - v2 * n10, v2 * n00 - v0 * n20, v2 * n01 - v0 * n21,
        v0 * n10 - v1 * n00, v0 * n11 - v1 * n01, v0 * n12 - v1 * n02,
        r * n00, r * n10, r * n20, r * n01, r * n11, r * n21, r * n02, r * n12, r * n22,
        s * m00, s * m01, s * m11, s * m02, s * m12, s * m22,
    )  # fmt: skip


@compiled
def assemble(
    turn: Floats,
    pose_sums: Floats,
    lens_sums: Floats,
    plane_sums: Floats,
    field_size: int,
    lens: int,
    has_plane: bool,
    normal: Floats,
) -> None:
    """Add the sums of all anchors and views to the equations.

    Shapes: ``turn`` (V, V, 9), ``pose_sums`` (V, V, 21), ``lens_sums`` (V, V, 5, 6), ``plane_sums`` (V, V, 9, 6),
    ``normal`` (G, G).

    * ``lens_sums``: Sums of ``B^T z`` with the product z of the derivatives by the point and by an unknown of the lens.
    * ``plane_sums``: Sums of ``c (B^T M s)^T``: by the plane, then by the pose of the anchor.
    """
    V = len(turn)
    block = 6 + field_size
    camera = block * (V - 1) + field_size
    own, half, bent, Q = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 9)), np.zeros((6, 6))
    for a in range(V):
        at_a = field_size + block * (a - 1)
        for k in range(a + 1, V):
            at_k = field_size + block * (k - 1)
            place = 0
            for p in range(3):
                for q in range(3):
                    Q[p, q] = Q[p + 3, q + 3] = turn[a, k, 3 * p + q]
                    own[p, q + 3] = own[q + 3, p] = pose_sums[a, k, 6 + 3 * p + q]
                for q in range(p + 1):
                    own[p, q] = own[q, p] = pose_sums[a, k, place]
                    own[p + 3, q + 3] = own[q + 3, p + 3] = pose_sums[a, k, 15 + place]
                    place += 1
            for p in range(6):
                of = 3 * (p // 3)
                for q in range(6):
                    half[p, q] = Q[p, of] * own[of, q] + Q[p, of + 1] * own[of + 1, q] + Q[p, of + 2] * own[of + 2, q]
                for c in range(lens):
                    z = Q[p, of] * lens_sums[a, k, c, of] + Q[p, of + 1] * lens_sums[a, k, c, of + 1]
                    normal[camera + c, at_k + p] += z + Q[p, of + 2] * lens_sums[a, k, c, of + 2]
                for q in range(9 if has_plane else 0):
                    z = Q[p, of] * plane_sums[a, k, q, of] + Q[p, of + 1] * plane_sums[a, k, q, of + 1]
                    bent[p, q] = z + Q[p, of + 2] * plane_sums[a, k, q, of + 2]
                    if q < 3:
                        normal[camera + lens + q, at_k + p] += bent[p, q]
            for p in range(6):
                for q in range(p + 1):
                    of = 3 * (q // 3)
                    z = half[p, of] * Q[q, of] + half[p, of + 1] * Q[q, of + 1]
                    normal[at_k + p, at_k + q] += z + half[p, of + 2] * Q[q, of + 2]
            for p in range(6 if a > 0 else 0):
                for q in range(6):
                    normal[at_k + p, at_a + q] -= half[p, q]
                    normal[at_a + p, at_a + q] += own[p, q]
                for c in range(lens):
                    normal[camera + c, at_a + p] -= lens_sums[a, k, c, p]
                for q in range(6 if has_plane else 0):
                    normal[at_k + p, at_a + q] += bent[p, q + 3]
                    normal[at_a + p, at_a + q] -= plane_sums[a, k, q + 3, p] + plane_sums[a, k, p + 3, q]
                for q in range(3 if has_plane else 0):
                    normal[camera + lens + q, at_a + p] -= plane_sums[a, k, q, p]
