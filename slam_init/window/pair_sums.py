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

from quest.jit import inlined
from slam_init.types.arrays import Floats
from slam_init.window.arguments import Layout, PairSums, Row, Scene, Track, TrackSums, TurnedSums
from slam_init.window.vectors import Six, Vector, by_pose, cross, joint


@inlined
def clear_pairs(scene: Scene, out: PairSums) -> None:
    """Set the sums to zero, and compute the relative poses."""
    out.pose[:], out.lens[:], out.plane[:] = 0.0, 0.0, 0.0
    R, t, turn = scene.R, scene.t, out.turn
    for a in range(len(R)):
        for k in range(len(R)):
            for p in range(3):
                for q in range(3):
                    element = R[k, p, 0] * R[a, q, 0] + R[k, p, 1] * R[a, q, 1] + R[k, p, 2] * R[a, q, 2]
                    turn[a, k, 3 * p + q] = element
            for q in range(3):
                moved = turn[a, k, q] * t[k, 0] + turn[a, k, 3 + q] * t[k, 1] + turn[a, k, 6 + q] * t[k, 2]
                out.shift[a, k, q] = moved - t[a, q]


@inlined
def to_anchor(turn: Floats, a: int, k: int, m: Vector) -> Vector:
    """``(R_k R_a^T)^T m``: a derivative by the point from the axes of view k into those of the anchor a."""
    return (
        m[0] * turn[a, k, 0] + m[1] * turn[a, k, 3] + m[2] * turn[a, k, 6],
        m[0] * turn[a, k, 1] + m[1] * turn[a, k, 4] + m[2] * turn[a, k, 7],
        m[0] * turn[a, k, 2] + m[1] * turn[a, k, 5] + m[2] * turn[a, k, 8],
    )


@inlined
def add_pose(track: Track, row: Row, pairs: PairSums, sums: TrackSums) -> None:
    """Add ``B^T M^T M B`` to the sums of the anchor and the view, and to the track what its anchor needs."""
    weight, c, d, v, r = row.weight, row.c, row.d, track.v, track.rho
    sums.pulls[0] = sums.pulls[0] + c[0] * row.h0 + d[0] * row.h1
    sums.pulls[1] = sums.pulls[1] + c[1] * row.h0 + d[1] * row.h1
    sums.pulls[2] = sums.pulls[2] + c[2] * row.h0 + d[2] * row.h1
    if track.anchor > 0:
        _couple_point(0, row.j0[0], row.j1[0], c, d, sums.coupled)
        _couple_point(1, row.j0[1], row.j1[1], c, d, sums.coupled)
        _couple_point(2, row.j0[2], row.j1[2], c, d, sums.coupled)
    # The rows of M^T M, then those of N = M^T M [v]x^T. Column p of B^T M^T M B is v x column p of N.
    m0, m1, m2 = (
        joint(c, d, weight * c[0], weight * d[0]),
        joint(c, d, weight * c[1], weight * d[1]),
        joint(c, d, weight * c[2], weight * d[2]),
    )
    n0, n1, n2 = cross(v, m0), cross(v, (m0[1], m1[1], m1[2])), cross(v, (m0[2], m1[2], m2[2]))
    x, y, z = cross(v, (n0[0], n1[0], n2[0])), cross(v, (n0[1], n1[1], n2[1])), cross(v, (n0[2], n1[2], n2[2]))
    a, k, s, out = track.anchor, row.k, r * r, pairs.pose
    out[a, k, 0] += x[0]
    out[a, k, 1] += x[1]
    out[a, k, 2] += y[1]
    out[a, k, 3] += x[2]
    out[a, k, 4] += y[2]
    out[a, k, 5] += z[2]
    if r == 0.0:  # a point at infinity shows no translation
        return
    out[a, k, 6] += r * n0[0]
    out[a, k, 7] += r * n1[0]
    out[a, k, 8] += r * n2[0]
    out[a, k, 9] += r * n0[1]
    out[a, k, 10] += r * n1[1]
    out[a, k, 11] += r * n2[1]
    out[a, k, 12] += r * n0[2]
    out[a, k, 13] += r * n1[2]
    out[a, k, 14] += r * n2[2]
    out[a, k, 15] += s * m0[0]
    out[a, k, 16] += s * m0[1]
    out[a, k, 17] += s * m1[1]
    out[a, k, 18] += s * m0[2]
    out[a, k, 19] += s * m1[2]
    out[a, k, 20] += s * m2[2]


@inlined
def _couple_point(p: int, j0: float, j1: float, c: Vector, d: Vector, coupled: Floats) -> None:
    """Add the product of unknown p of a track, weighted, with the point in the axes of the anchor."""
    coupled[p, 0] += j0 * c[0] + j1 * d[0]
    coupled[p, 1] += j0 * c[1] + j1 * d[1]
    coupled[p, 2] += j0 * c[2] + j1 * d[2]


@inlined
def add_depth(track: Track, row: Row, pairs: PairSums, sums: TrackSums) -> None:
    """Add ``c (B^T M s)^T``: on a plane, what moves the distance moves the point along s."""
    a, k, by = track.anchor, row.k, sums.by
    g0, g1 = row.weight * row.s0, row.weight * row.s1
    sums.depth[0] += row.s0 * row.h0 + row.s1 * row.h1
    sums.depth[1] += g0 * row.s0 + g1 * row.s1
    sums.by_depth[0] += row.l0[0] * g0 + row.l1[0] * g1
    sums.by_depth[1] += row.l0[1] * g0 + row.l1[1] * g1
    turned = by_pose(joint(row.c, row.d, g0, g1), track.v, track.rho)
    for q in range(9 if a > 0 else 3):
        add_six(turned, by[q if q < 3 else q + 3], pairs.plane, a, k, q)


@inlined
def add_six(six: Six, factor: float, out: Floats, a: int, k: int, q: int) -> None:
    """``out[a, k, q] += factor * six``."""
    out[a, k, q, 0] += six[0] * factor
    out[a, k, q, 1] += six[1] * factor
    out[a, k, q, 2] += six[2] * factor
    out[a, k, q, 3] += six[3] * factor
    out[a, k, q, 4] += six[4] * factor
    out[a, k, q, 5] += six[5] * factor


@inlined
def assemble(layout: Layout, pairs: PairSums, has_plane: bool, turned: TurnedSums, normal: Floats) -> None:
    """Add the sums of all anchors and views to the equations.

    Shapes: ``normal`` (G, G).
    """
    for a in range(len(pairs.turn)):
        for k in range(a + 1, len(pairs.turn)):
            _turn_into_view(a, k, pairs, has_plane, turned)
            _add_view(a, k, layout, pairs, has_plane, turned, normal)
            if a > 0:
                _add_anchor(a, k, layout, pairs, has_plane, turned, normal)


@inlined
def _turn_into_view(a: int, k: int, pairs: PairSums, has_plane: bool, out: TurnedSums) -> None:
    """Turn the sums of anchor a and view k into the axes of the view, on the side of the view."""
    turn, pose, plane, Q, own = pairs.turn, pairs.pose, pairs.plane, out.Q, out.own
    place = 0
    for p in range(3):
        for q in range(3):
            Q[p, q] = Q[p + 3, q + 3] = turn[a, k, 3 * p + q]
            own[p, q + 3] = own[q + 3, p] = pose[a, k, 6 + 3 * p + q]
        for q in range(p + 1):
            own[p, q] = own[q, p] = pose[a, k, place]
            own[p + 3, q + 3] = own[q + 3, p + 3] = pose[a, k, 15 + place]
            place += 1
    for p in range(6):
        of = 3 * (p // 3)
        for q in range(6):
            out.half[p, q] = Q[p, of] * own[of, q] + Q[p, of + 1] * own[of + 1, q] + Q[p, of + 2] * own[of + 2, q]
        for q in range(9 if has_plane else 0):
            z = Q[p, of] * plane[a, k, q, of] + Q[p, of + 1] * plane[a, k, q, of + 1]
            out.bent[p, q] = z + Q[p, of + 2] * plane[a, k, q, of + 2]


@inlined
def _add_view(
    a: int, k: int, layout: Layout, pairs: PairSums, has_plane: bool, turned: TurnedSums, normal: Floats
) -> None:
    """Add the products of the pose of view k with itself, with the lens, and with the plane."""
    at, lens, Q, half = layout.field + layout.block * (k - 1), pairs.lens, turned.Q, turned.half
    for p in range(layout.pose):
        of = 3 * (p // 3)
        for q in range(layout.lens):
            z = Q[p, of] * lens[a, k, q, of] + Q[p, of + 1] * lens[a, k, q, of + 1]
            normal[layout.focal + q, at + p] += z + Q[p, of + 2] * lens[a, k, q, of + 2]
        for q in range(3 if has_plane else 0):
            normal[layout.plane + q, at + p] += turned.bent[p, q]
        for q in range(p + 1):
            to = 3 * (q // 3)
            z = half[p, to] * Q[q, to] + half[p, to + 1] * Q[q, to + 1]
            normal[at + p, at + q] += z + half[p, to + 2] * Q[q, to + 2]


@inlined
def _add_anchor(
    a: int, k: int, layout: Layout, pairs: PairSums, has_plane: bool, turned: TurnedSums, normal: Floats
) -> None:
    """Add the products of the pose of anchor a with that of view k, with itself, with the lens, and with the plane."""
    at_a, at_k = layout.field + layout.block * (a - 1), layout.field + layout.block * (k - 1)
    plane = pairs.plane
    for p in range(layout.pose):
        for q in range(layout.pose):
            normal[at_k + p, at_a + q] -= turned.half[p, q]
            normal[at_a + p, at_a + q] += turned.own[p, q]
        for q in range(layout.lens):
            normal[layout.focal + q, at_a + p] -= pairs.lens[a, k, q, p]
        for q in range(6 if has_plane else 0):
            normal[at_k + p, at_a + q] += turned.bent[p, q + 3]
            normal[at_a + p, at_a + q] -= plane[a, k, q + 3, p] + plane[a, k, p + 3, q]
        for q in range(3 if has_plane else 0):
            normal[layout.plane + q, at_a + p] -= plane[a, k, q, p]
