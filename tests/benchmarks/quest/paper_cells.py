"""The measures of one solver at one noise level of the synthetic experiment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: The levels of the paper's figures, by scene.
NOISES_PX = {"general": (0.0, 0.5, 1.0, 2.0, 5.0, 10.0), "coplanar": (0.0, 0.25, 0.5, 1.0, 2.0)}


@dataclass(frozen=True)
class Cell:
    """The results of a solver on the problems of one scene and level."""

    #: closest, first: (B,) Rotation error of the candidate closest to the truth, and of the one ranked first.
    closest: Floats
    first: Floats
    #: direction, direction_of_first: (B,) Direction error of the translation of these two candidates.
    direction: Floats
    direction_of_first: Floats
    #: Mean number of candidates.
    candidates: float
    #: reached_by_first, reached_by_four: Share of problems from which refinement reaches the truth; NaN where it was
    #: not measured.
    reached_by_first: float
    reached_by_four: float
