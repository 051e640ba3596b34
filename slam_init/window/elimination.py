"""The compiled products of derivatives in the joint fit, and the elimination of the tracks (Schur complement)."""

from __future__ import annotations

import numpy as np

from quest.jit import inlined
from slam_init.types.arrays import Floats
from slam_init.window import arguments as at
from slam_init.window.arguments import LANES, ZOOM_TERMS, Equations, Layout, Observed, Room
from slam_init.window.compiler import part, to_view


@part
def clear(equations: Equations) -> None:
    """Set all sums over the tracks to zero."""
    for g in range(len(equations.gradient)):
        equations.gradient[g] = 0.0
        for m in range(len(equations.gradient)):
            equations.normal[g, m] = 0.0
    for n in range(len(equations.coupled)):
        for q in range(4 * LANES):
            equations.coupled[n, q] = 0.0


@part
def list_columns(k: int, a: int, has_plane: bool, layout: Layout, room: Room) -> int:
    """List the columns of an observation, and the common unknowns that they are by.

    * Returns: The number of columns.
    """
    slots, places, count = room.slots, room.places, 0
    view, anchor = layout.field + layout.block * (k - 1), layout.field + layout.block * (a - 1)
    for q in range(layout.pose if k != a else 0):
        if k > 0:
            slots[count], places[count], count = at.VIEW + q, view + q, count + 1
        if a > 0:
            slots[count], places[count], count = at.ANCHOR + q, anchor + q, count + 1
    for q in range(3 if has_plane and k != a else 0):
        slots[count], places[count], count = at.PLANE + q, layout.plane + q, count + 1
    for q in range(layout.lens):
        of = q if q < 2 or layout.readout else q + 1
        slots[count], places[count], count = at.LENS + of, layout.focal + q, count + 1
    field = view + layout.pose if k > 0 else 0
    for q in range(layout.field):
        # A zoom acts as the focal length does, and a shift as the principal point.
        of_zoom = at.LENS if q == 0 else at.LENS + 2 + q
        slots[count] = of_zoom if layout.field == ZOOM_TERMS else at.FIELD + q
        places[count], count = field + q, count + 1
    return count


@part
def couple(b: int, count: int, room: Room, equations: Equations) -> None:
    """Add the products of the columns of a block in a view to the equations, and the coupling of its tracks."""
    c, slots, places, normal, coupled, size = (
        room.table, room.slots, room.places, equations.normal, equations.coupled, len(equations.gradient)
    )  # fmt: skip
    x, y, z = at.TRACK, at.TRACK + 1, at.TRACK + 2
    for n in range(count):
        slot, place = slots[n], b * size + places[n]
        for lane in range(LANES):
            j0, j1 = c[slot, lane], c[slot, LANES + lane]
            coupled[place, lane] += c[x, lane] * j0 + c[x, LANES + lane] * j1
            coupled[place, LANES + lane] += c[y, lane] * j0 + c[y, LANES + lane] * j1
            coupled[place, 2 * LANES + lane] += c[z, lane] * j0 + c[z, LANES + lane] * j1
            coupled[place, 3 * LANES + lane] += c[at.RESIDUALS, lane] * j0 + c[at.RESIDUALS, LANES + lane] * j1
        for m in range(0, n + 1, 4):
            m1, m2, m3 = min(m + 1, n), min(m + 2, n), min(m + 3, n)
            p0, p1, p2, p3 = _products(c, 2 * LANES, slot, slots[m], slots[m1], slots[m2], slots[m3])
            _add_to_lower(normal, places[n], places[m], p0)
            if m < n:
                _add_to_lower(normal, places[n], places[m1], p1)
            if m + 1 < n:
                _add_to_lower(normal, places[n], places[m2], p2)
            if m + 2 < n:
                _add_to_lower(normal, places[n], places[m3], p3)


@inlined
def _add_to_lower(normal: Floats, row: int, column: int, value: float) -> None:
    normal[max(row, column), min(row, column)] += value


@part
def _products(
    rows: Floats, length: int, row: int, first: int, second: int, third: int, fourth: int
) -> tuple[float, float, float, float]:
    """The products of a row with four others: its numbers are read once for all of them."""
    p0, p1, p2, p3 = 0.0, 0.0, 0.0, 0.0
    for q in range(length):
        value = rows[row, q]
        p0 += value * rows[first, q]
        p1 += value * rows[second, q]
        p2 += value * rows[third, q]
        p3 += value * rows[fourth, q]
    return p0, p1, p2, p3


@part
def solve_tracks(b: int, hold: bool, observed: Observed, w: Floats, equations: Equations) -> None:
    """Invert the equations of the tracks of a block; with ``hold`` tracks at infinity stay there."""
    for lane in range(LANES):
        held = hold and w[at.RHO + lane] == 0.0 and w[at.ON_PLANE + lane] == 0.0 and w[at.GRADIENT[2] + lane] > 0.0
        free = 0.0 if held else w[at.FREE + lane]
        a00, a11 = w[at.OWN[0] + lane] * (1 + 1e-9) + 1e-9, w[at.OWN[3] + lane] * (1 + 1e-9) + 1e-9
        a10, a20, a21 = w[at.OWN[1] + lane], free * w[at.OWN[2] + lane], free * w[at.OWN[4] + lane]
        a22 = free * (w[at.OWN[5] + lane] * (1 + 1e-9) + 1e-9) + (1.0 - free)
        i0 = 1.0 / np.sqrt(a00)
        l10, l20 = a10 * i0, a20 * i0
        i1 = 1.0 / np.sqrt(a11 - l10 * l10)
        l21 = (a21 - l20 * l10) * i1
        i2 = free / np.sqrt(a22 - l20 * l20 - l21 * l21)
        w[at.FREE + lane] = free
        w[at.GRADIENT[2] + lane] *= free
        w[at.ROOT[0] + lane], w[at.ROOT[1] + lane], w[at.ROOT[2] + lane] = i0, l10, i1
        w[at.ROOT[3] + lane], w[at.ROOT[4] + lane], w[at.ROOT[5] + lane] = l20, l21, i2
    for lane in range(observed.counts[b]):
        i, slope, curvature = observed.tracks[b, lane], w[at.SLOPE + lane], w[at.CURVATURE + lane]
        equations.across[i] = slope * slope / curvature if curvature > 0.0 else 0.0
        equations.free[i] = w[at.FREE + lane] > 0.0
        i0, l10, i1 = w[at.ROOT[0] + lane], w[at.ROOT[1] + lane], w[at.ROOT[2] + lane]
        l20, l21, i2 = w[at.ROOT[3] + lane], w[at.ROOT[4] + lane], w[at.ROOT[5] + lane]
        # The rows of the inverse of the root; the inverse is the sum of their outer products.
        m10 = -l10 * i0 * i1
        m20, m21 = -(l20 * i0 + l21 * m10) * i2, -l21 * i1 * i2
        inverse = equations.inverses[i]
        inverse[0, 0], inverse[1, 1], inverse[2, 2] = i0 * i0 + m10 * m10 + m20 * m20, i1 * i1 + m21 * m21, i2 * i2
        inverse[0, 1] = inverse[1, 0] = m10 * i1 + m20 * m21
        inverse[0, 2] = inverse[2, 0] = m20 * i2
        inverse[1, 2] = inverse[2, 1] = m21 * i2
        for q in range(3):
            equations.own[i, q] = w[at.GRADIENT[q] + lane]


@part
def eliminate(b: int, w: Floats, equations: Equations, halves: Floats) -> None:
    """Take the tracks of a block out of the common equations (Schur complement).

    * ``halves``: Room (G + 1, 3 * LANES) for couplings and gradients over a root of the equations of the tracks.
    """
    normal, gradient, coupled, size = equations.normal, equations.gradient, equations.coupled, len(equations.gradient)
    for g in range(size + 1):
        n = b * size + g
        for lane in range(LANES):
            if g < size:
                first, second, third = coupled[n, lane], coupled[n, LANES + lane], coupled[n, 2 * LANES + lane]
            else:
                first, second = w[at.GRADIENT[0] + lane], w[at.GRADIENT[1] + lane]
                third = w[at.GRADIENT[2] + lane]
            first = w[at.ROOT[0] + lane] * first
            second = w[at.ROOT[2] + lane] * (second - w[at.ROOT[1] + lane] * first)
            third -= w[at.ROOT[3] + lane] * first + w[at.ROOT[4] + lane] * second
            halves[g, lane], halves[g, LANES + lane] = first, second
            halves[g, 2 * LANES + lane] = w[at.ROOT[5] + lane] * third
    for g in range(size):
        n, total = b * size + g, 0.0
        for lane in range(LANES):
            of_tracks = halves[g, lane] * halves[size, lane]
            of_tracks += halves[g, LANES + lane] * halves[size, LANES + lane]
            of_tracks += halves[g, 2 * LANES + lane] * halves[size, 2 * LANES + lane]
            coupled[n, 3 * LANES + lane] -= of_tracks
        for lane in range(LANES):
            total += coupled[n, 3 * LANES + lane]
        gradient[g] += total
    for m in range(0, size, 4):
        m1, m2, m3 = min(m + 1, size), min(m + 2, size), min(m + 3, size)
        for g in range(m, size):
            p0, p1, p2, p3 = _products(halves, 3 * LANES, g, m, m1, m2, m3)
            normal[g, m] -= p0
            if m < g:
                normal[g, m1] -= p1
            if m + 1 < g:
                normal[g, m2] -= p2
            if m + 2 < g:
                normal[g, m3] -= p3


@part
def turn_into_views(layout: Layout, R: Floats, equations: Equations) -> None:
    """Complete the equations, and turn them from the axes of the world into those of the views."""
    normal, gradient, size = equations.normal, equations.gradient, len(equations.gradient)
    for g in range(size):
        for m in range(g):
            normal[m, g] = normal[g, m]
    for k in range(1, len(R)):
        pose = layout.field + layout.block * (k - 1)
        for first in range(pose, pose + layout.pose, 3):
            for g in range(size):
                x, y, z = to_view(R, k, (normal[g, first], normal[g, first + 1], normal[g, first + 2]))
                normal[g, first], normal[g, first + 1], normal[g, first + 2] = x, y, z
            for g in range(size):
                x, y, z = to_view(R, k, (normal[first, g], normal[first + 1, g], normal[first + 2, g]))
                normal[first, g], normal[first + 1, g], normal[first + 2, g] = x, y, z
            x, y, z = to_view(R, k, (gradient[first], gradient[first + 1], gradient[first + 2]))
            gradient[first], gradient[first + 1], gradient[first + 2] = x, y, z
