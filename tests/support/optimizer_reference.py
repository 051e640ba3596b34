"""The optimizer of the joint fit in plain numpy, step by step, with the solution of LAPACK."""

from __future__ import annotations

import numpy as np

from slam_init.window.equations import WindowEquations
from slam_init.window.state import WindowState


def reference_optimum(
    equations: WindowEquations, state: WindowState, max_steps: int, tolerance: float
) -> tuple[WindowState, float, int]:
    """What :func:`slam_init.window.optimizer.optimize` gives: the last state, its cost, the number of steps."""
    cost, damping, steps, fell = equations.cost(state), 1e-4, 0, np.inf
    while steps < max_steps:
        equations.build(state)
        normal, gradient = equations.information(state), equations.gradient.copy()
        diagonal = np.diag(np.maximum(np.diag(normal), 1e-6))
        for _ in range(6):
            step = -np.linalg.solve(normal + damping * diagonal, gradient)
            moved = equations.moved(state, step)
            lower = equations.cost(moved)
            if lower < cost:
                break
            damping *= 10
        else:
            break
        steps += 1
        ratio, fell = (cost - lower) / fell, cost - lower
        if 0.3 < ratio < 1:
            further = equations.moved(state, step, min(1 / (1 - ratio), 6.0))
            if equations.cost(further) < lower:
                moved, lower = further, equations.cost(further)
        state, cost, damping = moved, lower, max(damping / 10, 1e-9)
        if fell < tolerance:
            break
    return state, cost, steps
