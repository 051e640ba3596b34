"""All solvers by name, with the properties that a caller needs to run any of them.

Each solver takes bearings ``m, n`` (N, 3) or (B, N, 3) and returns the rotations cam2_from_cam1 that the bearings allow
as unit quaternions wxyz: (K, 4), or (B, K, 4) padded with NaN. :func:`quest.paper.selection.select_candidates` ranks
the rotations and adds the translations.
"""

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
    handles_planes: bool = True
    #: Whether points that lie on no plane are solved exactly.
    handles_depth: bool = True


#: The solvers by the name of their function. Those of the paper are cited in :mod:`quest.paper`, the others in
#: :mod:`tests.benchmarks.quest.baselines`.
SOLVERS: dict[str, Solver] = {
    "quest5": Solver("QuEst 5", quest5, 5, False, 20),
    "quest6": Solver("QuEst 6", quest6, 6, True, 60),
    "quest6_fast": Solver("QuEst 6 fast", quest6_fast, 6, False, 12),
    "quest7": Solver("QuEst 7", quest7, 7, True, 12, handles_planes=False),
    "questn": Solver("QuEst N", questn, 7, True, 16),
    "five_point": Solver("5-point", five_point, 5, False, 20),
    "six_point": Solver("6-point", six_point, 6, True, 2, handles_planes=False),
    "seven_point": Solver("7-point", seven_point, 7, True, 6, handles_planes=False),
    "eight_point": Solver("8-point", eight_point, 8, True, 2, handles_planes=False),
    "homography": Solver("homography", homography, 4, True, 2, handles_depth=False),
}
