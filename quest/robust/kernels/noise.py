"""The inliers of a motion, their noise, and the matches that a motion explains by chance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import median_in_place, rotated, rotation_of_model
from quest.jit import compiled, part
from quest.robust.kernels.scoring import match_residual

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Ratios farther than this many median absolute deviations from the median belong to outliers. Where half of the depths
#: of a scene lie within a factor of two, all depths from a seventh of the median to infinity are within the bound.
_RATIO_MADS = 6.0
#: A ray nearer than 1e-6 rad to t has no usable epipolar line.
LEAST_SINE2 = 1e-12


@part
def _ratio_of_depth(m: Floats, n: Floats, i: int, R: Floats, t: Floats) -> float:
    """The ratio |t| / depth of match i; infinite without a usable epipolar line.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3).
    """
    n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
    a0, a1, a2 = rotated(R, m, i)
    s = n0 * t[0] + n1 * t[1] + n2 * t[2]
    l0, l1, l2 = t[0] - s * n0, t[1] - s * n1, t[2] - s * n2
    sine2 = l0 * l0 + l1 * l1 + l2 * l2
    return ((n0 - a0) * l0 + (n1 - a1) * l1 + (n2 - a2) * l2) / sine2 if sine2 > LEAST_SINE2 else np.inf


@compiled
def mark_typical(m: Floats, n: Floats, R: Floats, t: Floats, use: Bools) -> None:
    """Unmark the matches of untypical depth, by the distance of the ratio |t| / depth from the median.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), ``use`` (N,).

    * ``use``: The matches that count; of these, those of untypical depth, and those without a usable epipolar line, are
      set to False.
    """
    total, count = len(m), 0
    ratios, values = np.full(total, np.inf), np.empty(total)
    for i in range(total):
        if use[i]:
            ratios[i] = _ratio_of_depth(m, n, i, R, t)
            if ratios[i] < np.inf:
                values[count] = ratios[i]
                count += 1
    middle = spread = 0.0
    if count > 0:
        middle = median_in_place(values[:count])
        for i in range(count):
            values[i] = abs(values[i] - middle)
        spread = median_in_place(values[:count])
    for i in range(total):
        distance = abs(ratios[i] - middle)
        # Where half of the ratios are equal, only these are typical.
        use[i] = distance / spread <= _RATIO_MADS if spread > 0 else not distance > 0


@compiled
def typical_noise(m: Floats, n: Floats, model: Floats, threshold_rad: float) -> tuple[int, float]:
    """Number of inliers of typical depth, and the median of their absolute Sampson errors; 0 without such a match.

    Shapes: ``m, n`` (N, 3), ``model`` (7,).
    """
    R, t = rotation_of_model(model), model[4:]
    limit, total = threshold_rad * threshold_rad, len(m)
    r2, values, use = np.empty(total), np.empty(total), np.empty(total, np.bool_)
    for i in range(total):
        r2[i], behind = match_residual(m, i, n, i, R, t, 2 * limit)
        use[i] = r2[i] < limit and not behind
    mark_typical(m, n, R, t, use)
    count = 0
    for i in range(total):
        if use[i]:
            values[count] = r2[i]
            count += 1
    return count, np.sqrt(median_in_place(values[:count])) if count > 0 else 0.0


@compiled
def chance_inliers(
    m: Floats, n: Floats, model: Floats, threshold_rad: float, gate_rad: float, trials: int
) -> tuple[int, int]:
    """Numbers of wrong matches that a motion explains: within a gate, and within the threshold.

    Match i of camera 1 is compared with match i + 1 of camera 2, then with match i + 2 and so on.

    Shapes: ``m, n`` (N, 3), ``model`` (7,).

    * ``threshold_rad``: Below a parallax of sqrt(2) times this angle the sign of a depth is left open.
    """
    R, t = rotation_of_model(model), model[4:]
    limit, explained, loosely, total = threshold_rad * threshold_rad, 0, 0, len(m)
    for trial in range(trials):
        i = trial % total
        # No match is compared with itself.
        j = (i + 1 + (trial // total) % max(total - 1, 1)) % total
        r2, behind = match_residual(m, i, n, j, R, t, 2 * limit)
        if not behind:
            explained += r2 < gate_rad * gate_rad
            loosely += r2 < limit
    return explained, loosely
