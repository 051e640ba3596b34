"""Modes of the search: motions that refinement takes to the same optimum.

Models are rows (q_wxyz, t) of seven numbers, unit norm each.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, cos, radians

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Two modes nearer than this are one. Where the parallax is observable, refinement ends nearer to the optimum than
#: this.
_SAME_ROTATION_COSINE = cos(0.5 * radians(0.3))
_SAME_DIRECTION_COSINE = cos(radians(5.0))
#: Raw models scatter by several degrees about their mode. Only a model farther away than this is worth a refinement.
_CLEARLY_ELSEWHERE_RAD = radians(15.0)
#: Number of such models that are refined.
_MOST_ELSEWHERE = 3


def _cosines(a: Floats, b: Floats) -> tuple[float, float]:
    """Cosine of half the angle between the rotations, and of the angle between the directions, of two models."""
    # Slices and products of numpy take three times as long.
    w, x, y, z, i, j, k = (a * b).tolist()
    return abs(w + x + y + z), i + j + k


def same_mode(a: Floats, b: Floats) -> bool:
    """Whether two models belong to one mode.

    Shapes: ``a, b`` (7,).
    """
    rotation, direction = _cosines(a, b)
    return rotation > _SAME_ROTATION_COSINE and direction > _SAME_DIRECTION_COSINE


def _distance(a: Floats, b: Floats) -> float:
    """Angle between the rotations plus that between the directions of two models, radians."""
    rotation, direction = _cosines(a, b)
    return 2 * acos(min(1.0, rotation)) + acos(max(-1.0, min(1.0, direction)))


def spread_out(models: Sequence[Floats], best: Floats) -> list[Floats]:
    """Models that clearly differ from the best one and from each other, three at most.

    Shapes: ``models`` (7,), ``best`` (7,), returns (7,).
    """
    chosen: list[Floats] = []
    for model in models:
        if all(_distance(model, other) > _CLEARLY_ELSEWHERE_RAD for other in [best, *chosen]):
            chosen.append(model)
        if len(chosen) == _MOST_ELSEWHERE:
            break
    return chosen
