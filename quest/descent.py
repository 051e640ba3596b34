"""Levenberg and Marquardt's damped loop, for unknowns of any kind."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

State = TypeVar("State")

#: Factor of the damping after a step that fails, and its inverse after one that lowers the cost.
_FACTOR = 10.0


def descend(
    state: State,
    cost: float,
    step: Callable[[State, float], tuple[State, float]],
    *,
    steps: int,
    damping: float,
    most_damping: float,
    least_decrease: float,
    tolerance: float = 0.0,
) -> tuple[State, list[float]]:
    """Go down from a state by damped steps.

    * ``step``: The state after a step with some damping, and its cost; infinite where the step has no solution.
    * ``steps``: Largest number of steps.
    * ``damping``: Of the first step.
    * ``tolerance, least_decrease``: The steps end where one lowers the cost by a smaller share, or by less.
    * Returns: The last state, and the costs at the start and after each step.
    """
    costs = [cost]
    for _ in range(steps):
        moved, lower = state, math.inf
        while damping <= most_damping:
            moved, lower = step(state, damping)
            # At the optimum a step changes the cost by rounding only. It need not be tried again.
            if lower - cost <= tolerance * cost:
                break
            damping *= _FACTOR
        if not lower <= cost:
            break
        gain, cost, state, damping = cost - lower, lower, moved, damping / _FACTOR
        costs.append(cost)
        if gain <= max(tolerance * (cost + gain), least_decrease):
            break
    return state, costs
