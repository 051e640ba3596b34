"""The compiled equations of the priors: of the lens, of fields of correlated errors, of measured rotations."""

from __future__ import annotations

import numpy as np

from quest.jit import inlined
from slam_init.types.arrays import Floats
from slam_init.window.arguments import Equations, Known, Layout, Unknowns
from slam_init.window.compiler import part
from slam_init.window.vectors import Vector, dot, to_view


@part
def add_priors(known: Known, unknowns: Unknowns, layout: Layout, equations: Equations, fill: bool) -> float:
    """Cost of the distance of a state from what is expected; with ``fill`` it joins the equations."""
    cost, field = 0.0, unknowns.field
    for q in range(layout.lens):
        place = place_in_lens(layout, q)
        pull = unknowns.lens[place] - known.lens[place]
        cost += _pulled(layout.focal + q, pull, known, equations, fill)
    for k in range(len(field)):
        for q in range(layout.field):
            cost += _pulled(layout.block * k + q, field[k, q], known, equations, fill)
    for k in range(1, len(field)):
        if known.turned_weights[k] > 0.0:
            at, pull = layout.field + layout.block * (k - 1), turn_between(unknowns.R, known.turned, k)
            cost += _pulled(at, pull[0], known, equations, fill)
            cost += _pulled(at + 1, pull[1], known, equations, fill)
            cost += _pulled(at + 2, pull[2], known, equations, fill)
    return cost


@inlined
def place_in_lens(layout: Layout, q: int) -> int:
    """The place in :attr:`Unknowns.lens` of unknown q of the lens."""
    return q if q < 2 or layout.readout else q + 1


@inlined
def _pulled(column: int, pull: float, known: Known, equations: Equations, fill: bool) -> float:
    """The cost of an unknown that is off by ``pull`` from what is expected of it."""
    weight = known.weights[column]
    if fill:
        equations.gradient[column] += weight * pull
        equations.normal[column, column] += weight
    return float(weight * pull * pull)


@inlined
def turn_between(R: Floats, turned: Floats, k: int) -> Vector:
    """The rotation vector from a measured rotation to that of view k: the logarithm of ``R_k turned_k^T``."""
    x = to_view(R, k, (turned[k, 0, 0], turned[k, 0, 1], turned[k, 0, 2]))
    y = to_view(R, k, (turned[k, 1, 0], turned[k, 1, 1], turned[k, 1, 2]))
    z = to_view(R, k, (turned[k, 2, 0], turned[k, 2, 1], turned[k, 2, 2]))
    axis = (0.5 * (y[2] - z[1]), 0.5 * (z[0] - x[2]), 0.5 * (x[1] - y[0]))
    sine = np.sqrt(dot(axis, axis))
    angle = np.arctan2(sine, 0.5 * (x[0] + y[1] + z[2] - 1.0))
    factor = angle / sine if sine > 1e-12 else 1.0
    return factor * axis[0], factor * axis[1], factor * axis[2]
