"""Modes of the search: motions that refinement takes to the same optimum.

Models are rows (q_wxyz, t) of seven numbers, unit norm each.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Two modes nearer than this are one. Where the parallax is observable, refinement ends nearer to the optimum than
#: this.
_SAME_ROTATION_RAD = np.deg2rad(0.3)
_SAME_DIRECTION_RAD = np.deg2rad(5.0)
#: Raw models scatter by several degrees about their mode. Only a model farther away than this is worth a refinement.
_CLEARLY_ELSEWHERE_RAD = np.deg2rad(15.0)


def _distances(a: Floats, b: Floats) -> tuple[float, float]:
    """Angle between the rotations and angle between the directions of two models, radians."""
    # numpy takes three times as long for seven products.
    w, x, y, z, i, j, k = (a * b).tolist()
    return 2 * acos(min(1.0, abs(w + x + y + z))), acos(max(-1.0, min(1.0, i + j + k)))


def same_mode(a: Floats, b: Floats) -> bool:
    """Whether two models belong to one mode.

    Shapes: ``a, b`` (7,).
    """
    rotation, direction = _distances(a, b)
    return bool(rotation < _SAME_ROTATION_RAD and direction < _SAME_DIRECTION_RAD)


def spread_out(models: Sequence[Floats], best: Floats, count: int = 3) -> list[Floats]:
    """Models that clearly differ from the best one and from each other.

    Shapes: ``models`` (7,), ``best`` (7,), returns (7,).
    """
    chosen: list[Floats] = []
    for model in models:
        if all(sum(_distances(model, other)) > _CLEARLY_ELSEWHERE_RAD for other in [best, *chosen]):
            chosen.append(model)
        if len(chosen) == count:
            break
    return chosen
