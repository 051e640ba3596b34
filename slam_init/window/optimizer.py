"""The compiled optimizer of the joint fit: Levenberg and Marquardt's steps, from the equations to the last state.

A step takes some tenths of a millisecond, and nearly twice as long if Python calls its parts. So one call makes all
steps of a fit, without arrays of its own.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.window.arguments import (
    Equations,
    Known,
    Layout,
    Limits,
    Observed,
    Room,
    Unknowns,
)
from slam_init.window.compiler import compiled
from slam_init.window.kernel import evaluate
from slam_init.window.steps import move

#: Levenberg-Marquardt: first damping, the factor of a rejected step, and how often a step is tried.
_DAMPING, _RAISE, _TRIES = 1e-4, 10.0, 6
#: Robust costs converge linearly. A step that gains at least this share of what the step before gained is tried again
#: at up to this multiple of its length, which costs a fifth of new equations.
_SLOW, _LONGEST = 0.3, 6.0
#: All steps to come together gain at most this many times what the last one gained: a ratio of 0.95.
_STEPS_TO_COME = 20.0
#: Stiffness of the held baseline over that of its view.
_GAUGE = 1e4


@compiled
def optimize(
    observed: Observed,
    known: Known,
    layout: Layout,
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
    cost = evaluate(observed, known, layout, states[at], equations, room, yes, yes, no)
    damping, steps, fell, given_up = _DAMPING, 0, np.inf, False
    while steps < limits.max_steps:
        if steps:
            evaluate(observed, known, layout, states[at], equations, room, yes, yes, no)
        hold_length(equations.normal, states[at].t, held_view, layout)
        lower = np.inf
        for _ in range(_TRIES):
            if solve_damped(equations, damping, room):
                move(states[at], room.step, 1.0, observed, known, layout, equations, room, states[tried])
                lower = evaluate(observed, known, layout, states[tried], equations, room, no, no, no)
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
            move(states[at], room.step, longer, observed, known, layout, equations, room, states[spare])
            lowest = evaluate(observed, known, layout, states[spare], equations, room, no, no, no)
            if lowest < lower:
                tried, spare, lower = spare, tried, lowest
        at, tried = tried, at
        cost, damping = lower, max(damping / _RAISE, 1e-9)
        given_up = cost - _STEPS_TO_COME * fell > limits.hopeless or cost > limits.give_up
        if fell < limits.tolerance or given_up:
            break
    evaluate(observed, known, layout, states[at], equations, room, no, no, yes)
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
    weight = _GAUGE * stiffness / max(along[0] ** 2 + along[1] ** 2 + along[2] ** 2, 1e-300)
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
