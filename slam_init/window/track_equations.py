"""The equations of one track in the joint fit: the parts of :func:`slam_init.window.kernels.accumulate`."""

from __future__ import annotations

import numpy as np

from quest.jit import inlined
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.arguments import Equations, Fitted, Layout, Row, Track, TrackSums
from slam_init.window.compiler import compiled
from slam_init.window.vectors import Vector, by_pose, cross, dot, to_view, to_world, vector_of


@compiled
def collect(
    pixels: Floats,
    sigma_px: Floats,
    whitening: Floats,
    sweep_px_s: Floats,
    seen: Bools,
    anchor: Ints,
    observed: Floats,
    view: Ints,
    first: Ints,
) -> None:
    """Collect the observations of the tracks that take part, track by track.

    Shapes: ``pixels, sweep_px_s`` (V, T, 2), ``sigma_px, seen`` (V, T), ``whitening`` (V, T, 2, 2), ``anchor`` (T,),
    ``observed`` (N, 9), ``view`` (N,), ``first`` (T + 1,).

    * ``observed, view, first``: Receive the fields of :class:`slam_init.window.arguments.Observed`.
    """
    V, T = seen.shape
    n = 0
    for i in range(T):
        first[i] = n
        for k in range(V):
            if anchor[i] < 0 or not seen[k, i]:
                continue
            view[n] = k
            observed[n, 0], observed[n, 1], observed[n, 2] = pixels[k, i, 0], pixels[k, i, 1], 1.0 / sigma_px[k, i]
            observed[n, 3], observed[n, 4] = whitening[k, i, 0, 0], whitening[k, i, 0, 1]
            observed[n, 5], observed[n, 6] = whitening[k, i, 1, 0], whitening[k, i, 1, 1]
            observed[n, 7], observed[n, 8] = sweep_px_s[k, i, 0], sweep_px_s[k, i, 1]
            n += 1
    first[T] = n


@inlined
def depth_on_plane(R: Floats, t: Floats, a: int, d: Vector, plane: Floats, out: Floats) -> float:
    """Inverse distance of a ray to a plane.

    Shapes: ``R`` (V, 3, 3), ``t`` (V, 3), ``plane`` (3,), ``out`` (12,).

    * ``out``: Receives the derivatives by the plane, by the ray, and by the rotation and the translation of the view.
    """
    p, t_a = (plane[0], plane[1], plane[2]), vector_of(t, a)
    u, s, k = to_world(R, a, d), to_world(R, a, t_a), to_view(R, a, p)  # s is -c, with the centre c
    ku, den = dot(p, u), 1.0 - dot(p, (-s[0], -s[1], -s[2]))
    f = ku / (den * den)
    by_ray, by_t = cross(k, d), cross(k, t_a)
    for q in range(3):
        out[q] = u[q] / den + f * -s[q]
        out[3 + q] = k[q] / den
        out[6 + q] = by_ray[q] / den - f * by_t[q]
        out[9 + q] = -f * k[q]
    return float(ku / den)


@inlined
def clear_track(i: int, equations: Equations, sums: TrackSums) -> None:
    """Set the equations of a track to zero."""
    sums.A[:], sums.b[:], sums.share[:], sums.pulls[:], sums.coupled[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    sums.depth[:], sums.by_depth[:], sums.by_lens[:], sums.across[:] = 0.0, 0.0, 0.0, 0.0
    equations.back[i], equations.halves[i] = 0.0, 0.0
    if len(equations.shares):
        equations.shares[i] = 0.0


@inlined
def add_row(row: Row, sums: TrackSums) -> None:
    """Add an observation to the equations ``A = L^T W L``, ``b = L^T W e`` of the track, and to :attr:`Fitted.across`.

    The residual across the epipolar line is that along L_rho, turned by a right angle.
    """
    (x0, x1, x2), (y0, y1, y2), (j00, j01, j02), (j10, j11, j12) = row.l0, row.l1, row.j0, row.j1
    A, b, h0, h1 = sums.A, sums.b, row.h0, row.h1
    b[0] += x0 * h0 + y0 * h1
    b[1] += x1 * h0 + y1 * h1
    b[2] += x2 * h0 + y2 * h1
    A[0, 0] += j00 * x0 + j10 * y0
    A[1, 0] += j01 * x0 + j11 * y0
    A[1, 1] += j01 * x1 + j11 * y1
    A[2, 0] += j02 * x0 + j12 * y0
    A[2, 1] += j02 * x1 + j12 * y1
    A[2, 2] += j02 * x2 + j12 * y2
    sums.across[0] += x2 * h1 - y2 * h0
    sums.across[1] += row.weight * (x2 * x2 + y2 * y2)


@inlined
def couple_view(track: Track, row: Row, z: Vector, layout: Layout, equations: Equations, sums: TrackSums) -> None:
    """The gradient by the pose of view k, and the coupling of the track with it: a track is seen once in a view.

    * ``z``: The point, scaled by rho, relative to the camera centre of ``t_k = 0``: ``R_k R_a^T v``.
    """
    at = layout.field + layout.block * (row.k - 1)
    first, second = by_pose(row.a, z, track.rho), by_pose(row.b, z, track.rho)
    _couple(at, first[0], second[0], track.i, row, equations.back, sums.share)
    _couple(at + 1, first[1], second[1], track.i, row, equations.back, sums.share)
    _couple(at + 2, first[2], second[2], track.i, row, equations.back, sums.share)
    if layout.pose == 3:
        return
    _couple(at + 3, first[3], second[3], track.i, row, equations.back, sums.share)
    _couple(at + 4, first[4], second[4], track.i, row, equations.back, sums.share)
    _couple(at + 5, first[5], second[5], track.i, row, equations.back, sums.share)


@inlined
def _couple(at: int, g0: float, g1: float, i: int, row: Row, back: Floats, share: Floats) -> None:
    """The product of a common unknown, of which the residual has the derivatives g, with residual and track."""
    share[at] = g0 * row.h0 + g1 * row.h1
    back[i, 0, 4 + at] = row.j0[0] * g0 + row.j1[0] * g1
    back[i, 1, 4 + at] = row.j0[1] * g0 + row.j1[1] * g1
    back[i, 2, 4 + at] = row.j0[2] * g0 + row.j1[2] * g1


@inlined
def hold_at_infinity(track: Track, equations: Equations, fitted: Fitted, sums: TrackSums) -> None:
    """Hold the inverse distance of a track at infinity that would become negative."""
    if track.rho == 0.0 and not track.flat and sums.b[2] > 0.0:
        fitted.free[track.i], sums.b[2], sums.coupled[2, :] = False, 0.0, 0.0
        equations.back[track.i, 2, 4:] = 0.0


@inlined
def couple_anchor(track: Track, layout: Layout, equations: Equations, sums: TrackSums) -> None:
    """The gradient by the pose of the anchor and the coupling with it: ``-B^T`` times the sums by the point.

    On a plane the distance follows the pose of the anchor too.
    """
    at, flat, by = layout.field + layout.block * (track.anchor - 1), track.flat, sums.by
    turned = by_pose((sums.pulls[0], sums.pulls[1], sums.pulls[2]), track.v, track.rho)
    for q in range(layout.pose):
        sums.share[at + q] = -turned[q] + (sums.depth[0] * by[6 + q] if flat else 0.0)
    for p in range(3):
        turned = by_pose(vector_of(sums.coupled, p), track.v, track.rho)
        for q in range(layout.pose):
            equations.back[track.i, p, 4 + at + q] = -turned[q] + (sums.by_depth[p] * by[6 + q] if flat else 0.0)


@inlined
def couple_plane(track: Track, layout: Layout, equations: Equations, sums: TrackSums) -> None:
    """The information of a track about its plane by its depth, alone and with the anchor and the lens."""
    normal, by, at, plane = equations.normal, sums.by, layout.field + layout.block * (track.anchor - 1), layout.plane
    gradient, curvature = sums.depth[0], sums.depth[1]
    for p in range(3):
        sums.share[plane + p] = gradient * by[p]
        for q in range(3):
            equations.back[track.i, q, 4 + plane + p] = sums.by_depth[q] * by[p]
            normal[plane + p, plane + q] += curvature * by[p] * by[q]
        for q in range(layout.lens):
            normal[plane + p, layout.focal + q] += by[p] * sums.by_lens[q]
    for q in range(6 if track.anchor > 0 else 0):
        for p in range(6):
            normal[at + p, at + q] += curvature * by[6 + p] * by[6 + q]
        for p in range(3):
            normal[plane + p, at + q] += curvature * by[p] * by[6 + q]
        for p in range(layout.lens):
            normal[layout.focal + p, at + q] += sums.by_lens[p] * by[6 + q]


@inlined
def finish_track(track: Track, free: bool, equations: Equations, sums: TrackSums) -> None:
    """Solve the equations of a track, and add its gradient and its share to those of the common unknowns."""
    i, shares, halves, share, G = track.i, equations.shares, equations.halves, sums.share, len(sums.share)
    solve_track(i, sums.A, sums.b, 2 if (track.flat or not free) else 3, equations.back, halves)
    for q in range(G):
        equations.gradient[q] += share[q]
    if len(shares):
        for q in range(G):
            own = halves[i, 0, q] * halves[i, 0, G] + halves[i, 1, q] * halves[i, 1, G]
            shares[i, q] = share[q] - own - halves[i, 2, q] * halves[i, 2, G]


@compiled
def solve_track(i: int, A: Floats, b: Floats, unknowns: int, back: Floats, halves: Floats) -> None:
    """Invert the equations of a track.

    Shapes: ``A`` (3, 3), ``b`` (3,), ``back`` (T, 3, 4 + G), ``halves`` (T, 3, G + 1).

    * ``back``: Holds the coupling W in the last columns; receives b and the inverse.
    """
    G = back.shape[2] - 4
    for q in range(unknowns):
        A[q, q] = A[q, q] * (1 + 1e-9) + 1e-9
    i0 = 1.0 / np.sqrt(A[0, 0])
    l10, l20, l21, i2 = A[1, 0] * i0, 0.0, 0.0, 0.0
    i1 = 1.0 / np.sqrt(A[1, 1] - l10 * l10)
    if unknowns == 3:
        l20 = A[2, 0] * i0
        l21 = (A[2, 1] - l20 * l10) * i1
        i2 = 1.0 / np.sqrt(A[2, 2] - l20 * l20 - l21 * l21)
    for q in range(G):
        first = i0 * back[i, 0, 4 + q]
        second = i1 * (back[i, 1, 4 + q] - l10 * first)
        halves[i, 0, q], halves[i, 1, q], halves[i, 2, q] = (
            first,
            second,
            i2 * (back[i, 2, 4 + q] - l20 * first - l21 * second),
        )
    first = i0 * b[0]
    second = i1 * (b[1] - l10 * first)
    halves[i, 0, G], halves[i, 1, G], halves[i, 2, G] = first, second, i2 * (b[2] - l20 * first - l21 * second)
    # The rows of L^-1; the inverse is the sum of their outer products.
    m10 = -l10 * i0 * i1
    m20, m21 = -(l20 * i0 + l21 * m10) * i2, -l21 * i1 * i2
    back[i, 0, 0], back[i, 1, 0], back[i, 2, 0] = b[0], b[1], b[2]
    back[i, 0, 1], back[i, 1, 2], back[i, 2, 3] = i0 * i0 + m10 * m10 + m20 * m20, i1 * i1 + m21 * m21, i2 * i2
    back[i, 0, 2] = back[i, 1, 1] = m10 * i1 + m20 * m21
    back[i, 0, 3] = back[i, 2, 1] = m20 * i2
    back[i, 1, 3] = back[i, 2, 2] = m21 * i2


@compiled
def eliminate(normal: Floats, gradient: Floats, halves: Floats) -> None:
    """Take the tracks out of the common equations, in place (Schur complement).

    It is a product of a matrix with itself. The loop takes 1.5 times as long as BLAS, but a step that leaves the
    machine code for it takes longer. Two tracks at once, since the equations are then read and written half as often.

    Shapes: ``normal`` (G, G), ``gradient`` (G,), ``halves`` (T, 3, G + 1).

    * ``normal``: Of :func:`slam_init.window.kernels.accumulate`, the lower half; receives all of the equations.
    """
    size, odd = len(gradient), len(halves) % 2
    for i in range(odd):
        for p in range(size):
            a0, a1, a2 = halves[i, 0, p], halves[i, 1, p], halves[i, 2, p]
            for q in range(p + 1):
                normal[p, q] -= a0 * halves[i, 0, q] + a1 * halves[i, 1, q] + a2 * halves[i, 2, q]
            gradient[p] -= a0 * halves[i, 0, size] + a1 * halves[i, 1, size] + a2 * halves[i, 2, size]
    for i in range(odd, len(halves), 2):
        k = i + 1
        for p in range(size):
            a0, a1, a2 = halves[i, 0, p], halves[i, 1, p], halves[i, 2, p]
            b0, b1, b2 = halves[k, 0, p], halves[k, 1, p], halves[k, 2, p]
            for q in range(p + 1):
                first = a0 * halves[i, 0, q] + a1 * halves[i, 1, q] + a2 * halves[i, 2, q]
                normal[p, q] -= first + (b0 * halves[k, 0, q] + b1 * halves[k, 1, q] + b2 * halves[k, 2, q])
            first = a0 * halves[i, 0, size] + a1 * halves[i, 1, size] + a2 * halves[i, 2, size]
            gradient[p] -= first + (b0 * halves[k, 0, size] + b1 * halves[k, 1, size] + b2 * halves[k, 2, size])
    for p in range(size):
        for q in range(p):
            normal[q, p] = normal[p, q]
