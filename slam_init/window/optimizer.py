"""The compiled optimizer of the joint fit: Levenberg and Marquardt's steps, from the equations to the last state.

A step takes some tenths of a millisecond, and nearly twice as long if Python calls its parts. So one call makes all
steps of a fit, without arrays of its own.
"""

from __future__ import annotations

import numpy as np

from quest.algebra import copy_pose, tangents, turn
from slam_init.lenses.point import project_point
from slam_init.types.arrays import Floats
from slam_init.window.arguments import LANES, Equations, Layout, Limits, Problem, Room, Unknowns
from slam_init.window.compiler import compiled, part, to_world
from slam_init.window.kernel import evaluate, place_in_lens

#: Levenberg-Marquardt: first damping, the factor of a rejected step, and how often a step is tried.
_DAMPING, _RAISE, _TRIES = 1e-4, 10.0, 6
#: Robust costs converge linearly. A step that gains at least this share of what the step before gained is tried again
#: at up to this multiple of its length, which costs a fifth of new equations.
_SLOW, _LONGEST = 0.3, 6.0
#: All steps to come together gain at most this many times what the last one gained: a ratio of 0.95.
_STEPS_TO_COME = 20.0
#: Stiffness of the held baseline over that of its view.
_GAUGE = 1e4
#: A change of the lens that moves the pixels of a ray to first order by less than a hundredth.
_LEAST_CHANGE = 1e-3
#: Newton's method starts at the ray to first order; with two steps the pixel is exact to a thousandth.
_NEWTON_STEPS = 2


@compiled
def optimize(
    problem: Problem,
    held_view: int,
    limits: Limits,
    states: tuple[Unknowns, Unknowns, Unknowns],
    equations: Equations,
    room: Room,
) -> tuple[int, float, int, bool]:
    """Levenberg-Marquardt from the first of three states; the others are place for steps.

    * Returns: Which state is the answer, its cost, the number of steps, and whether the fit was given up. The costs and
      the residuals are those of the answer.
    """
    at, tried, spare = 0, 1, 2
    # Variables: for each of the constants True and False numba would compile the loops once more.
    yes = limits.max_steps >= 0
    no = not yes
    cost = evaluate(problem, states[at], equations, room, yes, yes, no)
    damping, steps, fell, given_up = _DAMPING, 0, np.inf, False
    while steps < limits.max_steps:
        if steps:
            evaluate(problem, states[at], equations, room, yes, yes, no)
        hold_length(equations.normal, states[at].t, held_view, problem.layout)
        lower = np.inf
        for _ in range(_TRIES):
            if solve_damped(equations, damping, room):
                move(problem, states[at], room.step, 1.0, equations, room, states[tried])
                lower = evaluate(problem, states[tried], equations, room, no, no, no)
                if lower < cost:
                    break
            damping *= _RAISE
        if not lower < cost:
            break
        steps += 1
        ratio, fell = (cost - lower) / fell, cost - lower
        if _SLOW < ratio < 1.0:
            # Where each step gains this share of the one before, the sum of all steps is so much longer (Aitken).
            longer = min(1.0 / (1.0 - ratio), _LONGEST)
            move(problem, states[at], room.step, longer, equations, room, states[spare])
            lowest = evaluate(problem, states[spare], equations, room, no, no, no)
            if lowest < lower:
                tried, spare, lower = spare, tried, lowest
        at, tried = tried, at
        cost, damping = lower, max(damping / _RAISE, 1e-9)
        given_up = cost - _STEPS_TO_COME * fell > limits.hopeless or cost > limits.give_up
        if fell < limits.tolerance or given_up:
            break
    evaluate(problem, states[at], equations, room, no, no, yes)
    return at, cost, steps, given_up


@compiled
def hold_length(normal: Floats, t: Floats, view: int, layout: Layout) -> None:
    """Hold the length of the baseline of a view, where there are baselines: images do not determine the scale.

    Shapes: ``normal`` (G, G), ``t`` (V, 3).
    """
    if view == 0 or layout.pose == 3:
        return
    at, along = layout.field + layout.block * (view - 1) + 3, t[view]
    stiffness = max(1.0, normal[at, at] + normal[at + 1, at + 1] + normal[at + 2, at + 2])
    weight = _GAUGE * stiffness / max(along[0] * along[0] + along[1] * along[1] + along[2] * along[2], 1e-300)
    for p in range(3):
        for q in range(3):
            normal[at + p, at + q] += weight * along[p] * along[q]


@compiled
def solve_damped(equations: Equations, damping: float, room: Room) -> bool:
    """Solve the equations with a share of their diagonal added, by elimination without pivots.

    * Returns: Whether a step was found; it is not where the damped equations are singular to working precision.
    """
    normal, factor, step, size = equations.normal, room.factor, room.step, len(equations.gradient)
    for p in range(size):
        step[p] = -equations.gradient[p]
        for q in range(p, size):
            factor[p, q] = normal[p, q]
        factor[p, p] += damping * max(normal[p, p], 1e-6)  # an unknown that nothing determines takes no step
    for p in range(size):
        pivot = factor[p, p]
        if not pivot > 0.0:
            return False
        inverse = 1.0 / pivot
        for r in range(p + 1, size):
            share = factor[p, r] * inverse
            for q in range(r, size):
                factor[r, q] -= share * factor[p, q]
            step[r] -= share * step[p]
    for p in range(size - 1, -1, -1):
        value = step[p]
        for q in range(p + 1, size):
            value -= factor[p, q] * step[q]
        step[p] = value / factor[p, p]
    return True


# -- how the tracks and the poses follow a step of the common unknowns -------------------------------------------------


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
    problem: Problem, before: Unknowns, step: Floats, length: float, equations: Equations, room: Room, after: Unknowns
) -> None:
    """The state after a step of the common unknowns, which the tracks follow by the last equations.

    Shapes: ``step`` (G,).
    """
    layout, world = problem.layout, room.turned
    for g in range(len(step)):
        world[g] = step[g]
    _move_views(before, step, length, layout, world, after)
    for q in range(3 if len(step) > layout.plane else 0):
        after.plane[q] = before.plane[q] + length * step[layout.plane + q]
    for q in range(len(before.lens)):
        after.lens[q] = before.lens[q]
    for q in range(layout.lens):
        after.lens[place_in_lens(layout, q)] += length * step[layout.focal + q]
    for b in range(len(problem.observed.tracks)):
        _move_tracks(b, problem, before, length, equations, room, after)


@part
def _move_tracks(
    b: int, problem: Problem, before: Unknowns, length: float, equations: Equations, room: Room, after: Unknowns
) -> None:
    """How the rays and inverse distances of a block of tracks follow the turned step of the common unknowns.

    A pixel of the anchor is measured, and its ray follows the lens. To first order it would leave its pixel by the
    square of the step: by several pixels where the distortion moves by a tenth. So the pixel moves to first order, and
    the ray is that of the pixel through the new lens.
    """
    observed, layout, world, followed = problem.observed, problem.layout, room.turned, room.tracks
    stretched, bent = length * world[layout.focal], length * world[layout.focal + 1]
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
            r0, r1, r2 = _through_lens(problem.known.camera, before.lens, stretched, bent, ray, r0, r1, r2)
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
