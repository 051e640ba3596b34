"""The linear eight-point algorithm on calibrated rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.benchmarks.quest.baselines.essential import as_samples, finish, null_space, rotations_of_essential


def eight_point(m: ArrayLike, n: ArrayLike) -> NDArray[np.float64]:
    """Rotations cam2_from_cam1 of the essential matrix that fits eight or more matches best.

    ``n . E m = 0`` is solved in least squares over E of unit norm. Bearings of unit norm need no normalization by
    Hartley's method. For points on a plane three dimensions of E fit, and the rotations are wrong.

    H. C. Longuet-Higgins, "A computer algorithm for reconstructing a scene from two projections", Nature 293, 1981.

    Shapes: ``m, n`` (N, 3), returns (2, 4).

    * Returns: Unit quaternions wxyz, canonical in sign, the twisted pair; the form is that of
      :func:`quest.paper.quest6`.
    """
    m, n, single = as_samples(m, n, at_least=8)
    q = rotations_of_essential(null_space(m, n, 1)[:, 0])
    return finish(q, m, n, single)
