"""Matched rays under a motion: residuals and inliers.

Models are rows (q_wxyz, t) of seven numbers, ``cam2_from_cam1``, |t| = 1; data are matches of unit bearings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


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
