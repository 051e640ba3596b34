"""How well the unit of a map is known: the mean distance of its landmarks in units of its baselines."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from slam_init.types.arrays import Floats


@dataclass(frozen=True, eq=False)
class UnitError:
    """The error of the mean distance of the landmarks, relative to the baselines. Errors of single ones average out.

    Attributes
    ----------
    own : float
        Relative standard deviation by the noise, the poses and the smooth errors of the views. NaN where nobody states
        it.
    by_lens : (4,) float
        How far four independent errors of unit variance move it: those of the focal length, of the principal point and
        of k1, as the map knows them. Maps with the same lens have these errors in common.
    """

    own: float = math.nan
    by_lens: Floats = field(default_factory=lambda: np.zeros(4))

    @property
    def sigma(self) -> float:
        """Relative standard deviation by all errors."""
        return math.hypot(self.own, *self.by_lens)

    def with_scale(self, variance: float) -> Self:
        """The same with a scale that is as uncertain besides."""
        return type(self)(math.sqrt(max(self.own**2 + variance, 0.0)), self.by_lens)
