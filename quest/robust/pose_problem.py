"""Matched rays under a motion: residuals and inliers; and modes: motions that refinement takes to the same optimum.

Models are rows (q_wxyz, t) of seven numbers, ``cam2_from_cam1``, |t| = 1; data are matches of unit bearings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import acos, cos, radians

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Two modes nearer than this are one. Where the parallax is observable, refinement ends nearer to the optimum than
#: this.
_SAME_ROTATION_COSINE = cos(0.5 * radians(0.3))
_SAME_DIRECTION_COSINE = cos(radians(5.0))
#: Raw models scatter by several degrees about their mode. Only a model farther away than this is worth a refinement.
_CLEARLY_ELSEWHERE_RAD = radians(15.0)
#: Number of such models that are refined.
_MOST_ELSEWHERE = 3


class PoseProblem:
    """Matched bearings, and what a motion makes of them, by the compiled loops of :mod:`quest.robust.kernels`.

    * ``m, n``: (N, 3) Unit bearings in camera 1 and camera 2.
    * ``threshold_rad``: Sampson error above which a match is an outlier.
    """

    def __init__(self, m: Floats, n: Floats, threshold_rad: float) -> None:
        self.m, self.n = np.ascontiguousarray(m), np.ascontiguousarray(n)
        self.threshold_rad = threshold_rad

    def __len__(self) -> int:
        return len(self.m)

    def residuals(self, model: Floats) -> Floats:
        """Squared residuals of all matches; infinite for a match behind a camera.

        Shapes: ``model`` (7,), returns (N,).
        """
        return kernels.residuals_of_model(self.m, self.n, model, self.threshold_rad)

    def explained(self, model: Floats, gate_rad: float) -> Bools:
        """Whether each match lies within the gate and in front of both cameras.

        Shapes: ``model`` (7,), returns (N,).
        """
        return np.asarray(self.residuals(model) < gate_rad**2)


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


def _is_near(a: Floats, b: Floats) -> bool:
    """Whether the angle between the rotations plus that between the directions of two models is small."""
    rotation, direction = _cosines(a, b)
    return 2 * acos(min(1.0, rotation)) + acos(max(-1.0, min(1.0, direction))) <= _CLEARLY_ELSEWHERE_RAD


def distinct_modes(models: Iterable[Floats], same: Callable[[Floats, Floats], bool] = same_mode) -> list[Floats]:
    """The models that do not belong to the mode of an earlier one.

    Shapes: ``models`` (7,), returns (7,).
    """
    distinct: list[Floats] = []
    for model in models:
        if not any(same(model, other) for other in distinct):
            distinct.append(model)
    return distinct


def spread_out(models: Iterable[Floats], best: Floats) -> list[Floats]:
    """Models that clearly differ from the best one and from each other, three at most.

    Shapes: ``models`` (7,), ``best`` (7,), returns (7,).
    """
    return distinct_modes([best, *models], _is_near)[1 : 1 + _MOST_ELSEWHERE]
