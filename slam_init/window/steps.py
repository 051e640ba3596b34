"""The compiled step of a joint fit: how the tracks and the poses follow a step of the common unknowns."""

from __future__ import annotations

import numpy as np

from quest.algebra import copy_pose, tangents, turn
from slam_init.lenses.point import project_point
from slam_init.types.arrays import Floats
from slam_init.window.arguments import Equations, Known, Layout, Observed, Room, Unknowns
from slam_init.window.compiler import compiled, part
from slam_init.window.kernel import place_in_lens
from slam_init.window.rows import LANES
from slam_init.window.vectors import to_world

#: A change of the lens that moves the pixels of a ray to first order by less than a hundredth.
_LEAST_CHANGE = 1e-3
#: Newton's method starts at the ray to first order; with two steps the pixel is exact to a thousandth.
_NEWTON_STEPS = 2


@part
def _through_lens(
    camera: Floats, lens: Floats, stretched: float, bent: float, ray: Floats, r0: float, r1: float, r2: float
) -> tuple[float, float, float]:
    """The ray of a pixel through a new lens; the ray to first order (r0, r1, r2) where there is none."""
    scale, k1 = np.exp(lens[0]), lens[1]
    seen, x, y, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(camera, scale, k1, ray[0], ray[1], ray[2])
    if not seen:
        return r0, r1, r2
    d0, d1, d2 = r0 - ray[0], r1 - ray[1], r2 - ray[2]
    x += a0 * d0 + a1 * d1 + a2 * d2 + (x - camera[3]) * stretched + f0 * bent
    y += b0 * d0 + b1 * d1 + b2 * d2 + (y - camera[4]) * stretched + f1 * bent
    scale, k1 = scale * np.exp(stretched), k1 + bent
    n0, n1, n2 = r0, r1, r2
    for _ in range(_NEWTON_STEPS):
        seen, u, v, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(camera, scale, k1, n0, n1, n2)
        # The shortest step: the ray does not move along itself.
        aa, ab, bb = a0 * a0 + a1 * a1 + a2 * a2, a0 * b0 + a1 * b1 + a2 * b2, b0 * b0 + b1 * b1 + b2 * b2
        det = aa * bb - ab * ab
        if not seen or det <= 0.0:
            return r0, r1, r2
        e0, e1 = (bb * (x - u) - ab * (y - v)) / det, (aa * (y - v) - ab * (x - u)) / det
        n0, n1, n2 = n0 + a0 * e0 + b0 * e1, n1 + a1 * e0 + b1 * e1, n2 + a2 * e0 + b2 * e1
    return n0, n1, n2


@compiled
def move(
    before: Unknowns,
    step: Floats,
    length: float,
    observed: Observed,
    known: Known,
    layout: Layout,
    equations: Equations,
    room: Room,
    after: Unknowns,
) -> None:
    """The state after a step of the common unknowns, which the tracks follow by the last equations.

    Shapes: ``step`` (G,).
    """
    world, followed = room.turned, room.tracks
    for g in range(len(step)):
        world[g] = step[g]
    _move_views(before, step, length, layout, world, after)
    for q in range(3 if len(step) > layout.plane else 0):
        after.plane[q] = before.plane[q] + length * step[layout.plane + q]
    for q in range(len(before.lens)):
        after.lens[q] = before.lens[q]
    for q in range(layout.lens):
        after.lens[place_in_lens(layout, q)] += length * step[layout.focal + q]
    stretched, bent = length * step[layout.focal], length * step[layout.focal + 1]
    for b in range(len(observed.tracks)):
        _move_tracks(b, before, length, stretched, bent, observed, known, equations, world, followed, after)


@part
def _move_tracks(
    b: int,
    before: Unknowns,
    length: float,
    stretched: float,
    bent: float,
    observed: Observed,
    known: Known,
    equations: Equations,
    world: Floats,
    followed: Floats,
    after: Unknowns,
) -> None:
    """How the rays and inverse distances of a block of tracks follow a step of the common unknowns.

    A pixel of the anchor is measured, and its ray follows the lens. To first order it would leave its pixel by the
    square of the step: by several pixels where the distortion moves by a tenth. So the pixel moves to first order, and
    the ray is that of the pixel through the new lens.

    Shapes: ``world`` (G,).
    """
    coupled, size = equations.coupled, len(world)
    bends = max(abs(stretched), abs(bent)) > _LEAST_CHANGE
    for row in range(3 * LANES):
        followed[row] = 0.0
    for g in range(size):
        along, n = world[g], b * size + g
        for row in range(3 * LANES):
            followed[row] += coupled[n, row] * along
    for lane in range(observed.counts[b]):
        i = observed.tracks[b, lane]
        own, inverse = equations.own[i], equations.inverses[i]
        g0, g1, g2 = own[0] + followed[lane], own[1] + followed[LANES + lane], own[2] + followed[2 * LANES + lane]
        first = -length * (inverse[0, 0] * g0 + inverse[0, 1] * g1 + inverse[0, 2] * g2)
        second = -length * (inverse[1, 0] * g0 + inverse[1, 1] * g1 + inverse[1, 2] * g2)
        farther = -length * (inverse[2, 0] * g0 + inverse[2, 1] * g1 + inverse[2, 2] * g2)
        ray = before.rays[i]
        x0, x1, x2, y0, y1, y2 = tangents(ray)
        r0 = ray[0] + first * x0 + second * y0
        r1 = ray[1] + first * x1 + second * y1
        r2 = ray[2] + first * x2 + second * y2
        if bends:
            r0, r1, r2 = _through_lens(known.camera, before.lens, stretched, bent, ray, r0, r1, r2)
        norm = max(np.sqrt(r0 * r0 + r1 * r1 + r2 * r2), 1e-300)
        after.rays[i, 0], after.rays[i, 1], after.rays[i, 2] = r0 / norm, r1 / norm, r2 / norm
        after.inverse_distances[i] = max(before.inverse_distances[i] + farther, 0.0)


@part
def _move_views(before: Unknowns, step: Floats, length: float, layout: Layout, world: Floats, after: Unknowns) -> None:
    """The poses and the fields of correlated errors after a step; ``world`` receives its poses in the world's axes.

    Shapes: ``step, world`` (G,).
    """
    place = 0
    for k in range(len(before.R)):
        copy_pose(before.R[k], before.t[k], after.R[k], after.t[k])
        for q in range(before.field.shape[1]):
            after.field[k, q] = before.field[k, q]
        if k > 0:
            for at in range(place, place + layout.pose, 3):
                world[at], world[at + 1], world[at + 2] = to_world(before.R, k, (step[at], step[at + 1], step[at + 2]))
            turn(after.R[k], length * step[place], length * step[place + 1], length * step[place + 2])
            for q in range(layout.pose - 3):
                after.t[k, q] += length * step[place + 3 + q]
            place += layout.pose
        for q in range(layout.field):
            after.field[k, q] += length * step[place + q]
        place += layout.field
