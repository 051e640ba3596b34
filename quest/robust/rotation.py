"""The rotation that explains most matches by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels

Floats = NDArray[np.float64]

#: From this number of matches the share of inliers of a hypothesis is known to 4 %.
_TEST_MATCHES = 150
#: Where a quarter of the matches are inliers, the least share of a rotation that counts, 128 pairs hold a pair of two
#: inliers with a probability of 99.97 %. The best of 200 pairs is nearer to an exact rotation: with 128, points at
#: infinity without noise looked like a plane.
_PAIRS = 200
#: Two rays that are nearer to each other, or to opposite directions, determine no rotation: the frame that they span is
#: orthonormal to 1e-16 divided by this angle.
_LEAST_ANGLE_RAD = 1e-6


def propose_rotation(m: Floats, n: Floats, threshold_rad: float, rng: np.random.Generator) -> Floats:
    """Find the rotation that explains most matches, by some hundred of them.

    Shapes: ``m, n`` (N, 3), returns (3, 3).

    * ``threshold_rad``: Residual above which a match has little weight, as in :func:`quest.estimate_relative_pose`.
    """
    # Some hundred matches decide which rotation is best.
    if len(m) > _TEST_MATCHES:
        some = rng.permutation(len(m))[:_TEST_MATCHES]
        m, n = m[some], n[some]
    best = np.empty((3, 3))
    if not kernels.best_rotation(m, n, rng.random((_PAIRS, 2)), threshold_rad, _LEAST_ANGLE_RAD, best):
        # Where no pair determines a rotation, as where all rays are equal, the Kabsch fit gives one of those that fit
        # best.
        best = refine_rotation(np.eye(3), m, n, 1.0, iterations=1)
    return settle_rotation(best, m, n, threshold_rad)


def settle_rotation(R: Floats, m: Floats, n: Floats, threshold_rad: float) -> Floats:
    """Refine a rotation with a scale that falls from four times the threshold to half of it.

    Shapes: ``R`` (3, 3), ``m, n`` (N, 3), returns (3, 3).
    """
    # The wide scale first, so that a scene with a little parallax is fitted as a whole.
    return refine_rotation(R, m, n, 4 * threshold_rad, threshold_rad, 0.5 * threshold_rad)


def fit_rotation(m: Floats, n: Floats, threshold_rad: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Fit the rotation that explains most matches.

    Shapes: ``m, n`` (N, 3), returns ``R`` (3, 3), returns ``r2`` (N,).

    * ``threshold_rad``: Residual above which a match has little weight, as in :func:`quest.estimate_relative_pose`.
    """
    best = settle_rotation(propose_rotation(m, n, threshold_rad, rng), m, n, threshold_rad)
    return best, 0.5 * np.sum((n - m @ best.T) ** 2, axis=1)


def refine_rotation(R: Floats, m: Floats, n: Floats, *scales_rad: float, iterations: int = 10) -> Floats:
    """Robust rotation ``n = R m``: iteratively re-weighted Kabsch with the weights of Geman and McClure.

    Shapes: ``R`` (3, 3), ``m, n`` (N, 3), returns (3, 3).

    * ``scales_rad``: Of the weights, one after the other: a wide one first, so that every match counts.
    * ``iterations``: At each scale.
    """
    R, m, n = R.copy(), np.ascontiguousarray(m), np.ascontiguousarray(n)
    for scale_rad in scales_rad:
        kernels.refine_rotation(m, n, R, scale_rad, iterations)
    return R
