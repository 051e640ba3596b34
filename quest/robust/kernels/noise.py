"""The inliers of a motion, their noise, and the matches that a motion explains by chance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import median_in_place, rotation_of_model
from quest.jit import compiled, part
from quest.robust.kernels.scoring import match_residual

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@part
def ratio_of_depth(m: Floats, i: int, n: Floats, j: int, R: Floats, t: Floats, least_sine2: float) -> float:
    """The ratio |t| / depth of ray ``m[i]`` matched with ``n[j]``; infinite without a usable epipolar line.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3).
    """
    n0, n1, n2 = n[j, 0], n[j, 1], n[j, 2]
    d0 = n0 - (R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2])
    d1 = n1 - (R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2])
    d2 = n2 - (R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2])
    s = n0 * t[0] + n1 * t[1] + n2 * t[2]
    l0, l1, l2 = t[0] - s * n0, t[1] - s * n1, t[2] - s * n2
    sine2 = l0 * l0 + l1 * l1 + l2 * l2
    return (d0 * l0 + d1 * l1 + d2 * l2) / sine2 if sine2 > least_sine2 else np.inf


@part
def distances_from_typical(
    m: Floats, n: Floats, R: Floats, t: Floats, least_sine2: float, use: Bools
) -> tuple[Floats, float, float]:
    """Distance of the ratio |t| / depth of each match from the median, in median absolute deviations.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), ``use`` (N,), returns ``distances`` (N,).

    * ``use``: The matches that count; the others, and those without a usable epipolar line, are at infinity.
    * Returns: The distances, the median, and the median absolute deviation.
    """
    total, count = len(m), 0
    ratios, values = np.full(total, np.inf), np.empty(total)
    for i in range(total):
        if use[i]:
            ratios[i] = ratio_of_depth(m, i, n, i, R, t, least_sine2)
            if ratios[i] < np.inf:
                values[count] = ratios[i]
                count += 1
    if count == 0:
        return ratios, 0.0, 0.0
    middle = median_in_place(values[:count])
    for i in range(count):
        values[i] = abs(values[i] - middle)
    spread = median_in_place(values[:count])
    for i in range(total):
        ratios[i] = distance_from_typical(ratios[i], middle, spread)
    return ratios, middle, spread


@part
def distance_from_typical(ratio: float, middle: float, spread: float) -> float:
    """The distance of one ratio. Where half of the ratios are equal, only these are typical."""
    distance = abs(ratio - middle)
    if spread > 0:
        return distance / spread
    return np.inf if distance > 0 else 0.0


@compiled
def mark_typical(m: Floats, n: Floats, R: Floats, t: Floats, mads: float, least_sine2: float, use: Bools) -> None:
    """Unmark the matches of untypical depth.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), ``use`` (N,).

    * ``mads``: Largest distance of a typical ratio from the median, in median absolute deviations.
    * ``use``: The matches that count; of these, those of untypical depth are set to False.
    """
    distances, _, _ = distances_from_typical(m, n, R, t, least_sine2, use)
    for i in range(len(m)):
        use[i] = distances[i] <= mads


@compiled
def typical_noise(
    m: Floats, n: Floats, model: Floats, threshold_rad: float, mads: float, least_sine2: float
) -> tuple[int, float]:
    """Number of inliers of typical depth, and the median of their absolute Sampson errors; 0 without such a match.

    Shapes: ``m, n`` (N, 3), ``model`` (7,).
    """
    R, t = rotation_of_model(model), model[4:]
    limit, total = threshold_rad * threshold_rad, len(m)
    r2, values, use = np.empty(total), np.empty(total), np.empty(total, np.bool_)
    for i in range(total):
        r2[i], behind = match_residual(m, i, n, i, R, t, 2 * limit)
        use[i] = r2[i] < limit and not behind
    mark_typical(m, n, R, t, mads, least_sine2, use)
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
