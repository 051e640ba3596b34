"""The information of an observation about shared unknowns: the lens, and the correlated errors of its view."""

from __future__ import annotations

from quest.jit import inlined
from slam_init.types.arrays import Floats
from slam_init.window.arguments import ZOOM_TERMS, Equations, Layout, Observed, PairSums, Row, Track, TrackSums
from slam_init.window.pair_sums import add_six
from slam_init.window.vectors import by_pose, joint


@inlined
def whitening(n: int, records: Floats) -> tuple[float, float, float, float]:
    """The matrix (2, 2), row by row, that turns an offset of the pixel into units of the noise."""
    inverse = records[n, 2]
    return records[n, 3] * inverse, records[n, 4] * inverse, records[n, 5] * inverse, records[n, 6] * inverse


@inlined
def differentiate_lens(
    n: int, by_x: float, by_y: float, f0: float, f1: float, observed: Observed, layout: Layout, out: Floats
) -> None:
    """Derivatives (2, 5) of the residual by the lens: focal length, k1, then readout and principal point if unknown.

    * ``by_x, by_y, f0, f1``: Derivatives of the pixel by the logarithm of the focal length, and by k1.
    """
    records = observed.records
    w00, w01, w10, w11 = whitening(n, records)
    out[0, 0], out[1, 0], out[0, 1], out[1, 1] = by_x, by_y, f0, f1
    if layout.readout:
        out[0, 2], out[1, 2] = records[n, 7], records[n, 8]
    if layout.principal:
        x, y = layout.lens - 2, layout.lens - 1
        out[0, x], out[1, x], out[0, y], out[1, y] = 1.0, 0.0, 0.0, 1.0
    for p in range(layout.lens):
        g0, g1 = out[0, p], out[1, p]
        out[0, p], out[1, p] = w00 * g0 + w01 * g1, w10 * g0 + w11 * g1


@inlined
def add_lens(track: Track, row: Row, layout: Layout, equations: Equations, pairs: PairSums, sums: TrackSums) -> None:
    """Add the products of the derivatives by the lens with the residual and with those by the other unknowns."""
    i, k, a, focal, back = track.i, row.k, track.anchor, layout.focal, equations.back
    (x0, x1, x2), (y0, y1, y2) = row.j0, row.j1
    for p in range(layout.lens):
        g0, g1 = sums.lens[0, p], sums.lens[1, p]
        sums.share[focal + p] += g0 * row.h0 + g1 * row.h1
        back[i, 0, 4 + focal + p] += x0 * g0 + y0 * g1
        back[i, 1, 4 + focal + p] += x1 * g0 + y1 * g1
        back[i, 2, 4 + focal + p] += x2 * g0 + y2 * g1
        g0, g1 = row.weight * g0, row.weight * g1
        for q in range(p + 1):
            equations.normal[focal + p, focal + q] += g0 * sums.lens[0, q] + g1 * sums.lens[1, q]
        if k == a:
            continue
        turned = by_pose(joint(row.c, row.d, g0, g1), track.v, track.rho)
        add_six(turned, 1.0, pairs.lens, a, k, p)
        if track.flat:
            sums.by_lens[p] += row.s0 * g0 + row.s1 * g1


@inlined
def add_field(
    track: Track,
    row: Row,
    observed: Observed,
    layout: Layout,
    equations: Equations,
    turn: Floats,
    sums: TrackSums,
) -> None:
    """Add the information of an observation about the field of its view, and about the other unknowns.

    The field is that of correlated errors, or the zoom and the shift of the view.

    Shapes: ``turn`` (V, V, 9).
    """
    i, k, a, field, focal = track.i, row.k, track.anchor, layout.field, layout.focal
    normal, by = equations.normal, sums.by
    first = field + layout.block * (k - 1) + layout.pose if k > 0 else 0
    at_a = field + layout.block * (a - 1)
    (x0, x1, x2), (y0, y1, y2) = row.l0, row.l1
    for p in range(field):
        f0, f1 = _by_field(p, track, row, observed, layout, sums)
        sums.share[first + p] += f0 * row.h0 + f1 * row.h1
        g0, g1 = row.weight * f0, row.weight * f1
        equations.back[i, 0, 4 + first + p] = g0 * x0 + g1 * y0
        equations.back[i, 1, 4 + first + p] = g0 * x1 + g1 * y1
        equations.back[i, 2, 4 + first + p] = g0 * x2 + g1 * y2
        for q in range(p + 1):
            f0, f1 = _by_field(q, track, row, observed, layout, sums)
            normal[first + p, first + q] += g0 * f0 + g1 * f1
        for q in range(layout.lens):
            normal[focal + q, first + p] += g0 * sums.lens[0, q] + g1 * sums.lens[1, q]
        if k == a:
            continue
        depth = g0 * row.s0 + g1 * row.s1
        turned = by_pose(joint(row.c, row.d, g0, g1), track.v, track.rho)
        if a > 0:
            for q in range(layout.pose):
                by_anchor = -turned[q] + (depth * by[6 + q] if track.flat else 0.0)
                normal[first + p, at_a + q] += by_anchor
        for q in range(3 if track.flat else 0):
            normal[layout.plane + q, first + p] += depth * by[q]
        for q in range(layout.pose if k > 0 else 0):
            of, at = 3 * (q // 3), 3 * (q % 3)
            by_view = turn[a, k, at] * turned[of] + turn[a, k, at + 1] * turned[of + 1]
            normal[first + p, first - layout.pose + q] += by_view + turn[a, k, at + 2] * turned[of + 2]


@inlined
def _by_field(
    p: int, track: Track, row: Row, observed: Observed, layout: Layout, sums: TrackSums
) -> tuple[float, float]:
    """The derivative of the residual by coefficient p of the field of a view, or by its zoom and its shift."""
    records, n, half = observed.records, row.n, layout.field // 2
    if layout.field == ZOOM_TERMS:
        # A zoom acts as the focal length does.
        if p == 0:
            return sums.lens[0, 0], sums.lens[1, 0]
        return records[n, 2 + p] * records[n, 2], records[n, 4 + p] * records[n, 2]
    place = observed.places[row.k, track.i, p % half]
    return records[n, 3 + p // half] * place, records[n, 5 + p // half] * place
