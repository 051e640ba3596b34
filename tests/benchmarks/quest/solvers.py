"""All solvers by name, with the properties that a caller needs to run any of them.

Each solver takes bearings ``m, n`` (N, 3) or (B, N, 3) and returns the rotations cam2_from_cam1 that the bearings allow
as unit quaternions wxyz: (K, 4), or (B, K, 4) padded with NaN. :func:`quest.paper.selection.select_candidates` ranks
the rotations and adds the translations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quest.paper.quest5 import quest5
from quest.paper.quest6 import quest6
from quest.paper.quest6_fast import quest6_fast
from quest.paper.quest7 import quest7
from quest.paper.questn import questn
from tests.benchmarks.quest.baselines import eight_point, five_point, homography, seven_point, six_point


@dataclass(frozen=True)
class Solver:
    """A solver of the relative rotation."""

    #: Name of the solver in tables.
    name: str
    #: ``function(m, n)``, see the module docstring.
    function: Callable[..., NDArray[np.float64]]
    #: The smallest number of matches.
    sample_size: int
    #: Whether a sample may hold more matches than that.
    takes_more: bool
    #: Largest number of candidates of a sample.
    most_candidates: int
    #: Whether points on a plane are solved exactly.
    handles_planes: bool
    #: Whether points that lie on no plane are solved exactly.
    handles_depth: bool
    #: Source of the method.
    citation: str


_F17 = "Fathian et al., arXiv:1704.02672, 2017"

#: The solvers by the name of their function.
SOLVERS: dict[str, Solver] = {
    "quest5": Solver("QuEst 5", quest5, 5, False, 20, True, True, "Fathian et al., IEEE RA-L, 2018"),
    "quest6": Solver("QuEst 6", quest6, 6, True, 60, True, True, _F17),
    "quest6_fast": Solver("QuEst 6 fast", quest6_fast, 6, False, 12, True, True, f"{_F17}; deflated"),
    "quest7": Solver("QuEst 7", quest7, 7, True, 12, False, True, _F17),
    "questn": Solver("QuEst N", questn, 7, True, 16, True, True, f"{_F17}; deflated, any number of matches"),
    "five_point": Solver("5-point", five_point, 5, False, 20, True, True, "Stewenius, Engels, Nister, ISPRS J., 2006"),
    "six_point": Solver("6-point", six_point, 6, True, 2, False, True, "Philip, TRITA-MAT-1998-MA-13, 1998"),
    "seven_point": Solver("7-point", seven_point, 7, True, 6, False, True, "Hartley, Zisserman, 2004, section 11.1.2"),
    "eight_point": Solver("8-point", eight_point, 8, True, 2, False, True, "Longuet-Higgins, Nature 293, 1981"),
    "homography": Solver("homography", homography, 4, True, 2, True, False, "Ma et al., 2004, section 5.3.3"),
}
