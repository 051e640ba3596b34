"""Residuals of a pose, and its score: the truncated sum of squared residuals.

References
----------
.. [T00] P. H. S. Torr, A. Zisserman, "MLESAC", CVIU 2000 (the truncated cost, there MSAC).
.. [M05] J. Matas, O. Chum, "Randomized RANSAC with sequential probability ratio test", ICCV 2005.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import rotated, rotation_of_model
from quest.jit import compiled, part

Floats = NDArray[np.float64]

#: A model is given up where the logarithm of the likelihood ratio falls below this value. One good model in a hundred
#: is given up.
_REFUTED = -4.6
#: Number of matches whose errors are computed at once. A bad model is refuted after ten to thirty matches.
_BLOCK = 32


@part
def match_residual(m: Floats, i: int, n: Floats, j: int, R: Floats, t: Floats, flat: float) -> tuple[float, bool]:
    """Squared Sampson error of a match, and whether the match lies behind a camera beyond doubt.

    Shapes: ``m`` (N, 3), ``n`` (N, 3), ``R, t`` (3, 3).

    * ``flat``: The sign of a depth is beyond doubt where the squared sine of the parallax exceeds this value.
    """
    a0, a1, a2 = rotated(R, m, i)
    n0, n1, n2 = n[j, 0], n[j, 1], n[j, 2]
    p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n0 * t[0] + n1 * t[1] + n2 * t[2]
    c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
    e = c0 * t[0] + c1 * t[1] + c2 * t[2]
    r2 = e * e / max(2 - p * p - s * s - 2 * e * e, 1e-12)
    cosine = a0 * n0 + a1 * n1 + a2 * n2
    observable = c0 * c0 + c1 * c1 + c2 * c2 > flat
    return r2, observable and (cosine * s < p or s < cosine * p)


@compiled
def residuals_of_model(m: Floats, n: Floats, model: Floats, threshold_rad: float) -> Floats:
    """Squared residuals of a pose in one row; infinite for a match behind a camera.

    Shapes: ``m, n`` (N, 3), ``model`` (7,), returns (N,).

    * ``threshold_rad``: Sampson error above which a match is an outlier. Below a parallax of sqrt(2) times this angle
      the sign of a depth is left open.
    """
    R, t, r2 = rotation_of_model(model), model[4:], np.empty(len(m))
    for i in range(len(m)):
        r2[i], behind = match_residual(m, i, n, i, R, t, 2 * threshold_rad * threshold_rad)
        if behind:
            r2[i] = np.inf
    return r2


@compiled
def rays_by_row(m: Floats, n: Floats) -> Floats:
    """Matches with one row for each coordinate, so that the compiler treats several matches at once.

    Shapes: ``m, n`` (N, 3), returns (6, N).
    """
    rays = np.empty((6, len(m)))
    for i in range(len(m)):
        for k in range(3):
            rays[k, i], rays[3 + k, i] = m[i, k], n[i, k]
    return rays


@compiled
def score_or_refute(
    rays: Floats, R: Floats, t: Floats, threshold_rad: float, bail: float, good: float, bad: float
) -> tuple[float, int, float]:
    """Truncated sum of squared Sampson errors and number of inliers (MSAC [T00]_).

    The loop stops once the sum exceeds ``bail``: no better pose is lost, since the sum only grows. It stops as well
    where the matches refute a good pose.

    The matches are a sequence of trials. A good pose explains each with probability ``good``, a bad one with
    probability ``bad``. The likelihood ratio of the two is followed (Wald's sequential test, for RANSAC [M05]_) where
    ``good`` is more than 1.5 times ``bad``.

    Shapes: ``rays`` (6, N), ``R, t`` (3, 3).

    * ``rays``: Unit bearings by row, see :func:`rays_by_row`, in random order.
    * ``good, bad``: Share of matches that a good pose and a bad pose explain; zero for no test.
    * Returns ``share``: Share of inliers among the matches up to the end of the loop.
    """
    limit = threshold_rad * threshold_rad
    cost, inliers, evidence = 0.0, 0, 0.0
    tested = good > 1.5 * bad and bad > 0
    for_hit = np.log(good / bad) if tested else 0.0
    for_miss = np.log((1 - good) / (1 - bad)) if tested else 0.0
    values, count = np.empty(_BLOCK), rays.shape[1]
    for start in range(0, count, _BLOCK):
        _truncated(rays, start, R, t, limit, values)
        for j in range(min(_BLOCK, count - start)):
            value = values[j]
            cost += value
            if value < limit:
                inliers += 1
                evidence += for_hit
            else:
                evidence += for_miss
                if cost > bail or evidence < _REFUTED:
                    return np.inf, 0, inliers / (start + j + 1)
    return cost, inliers, inliers / count


@part
def _truncated(rays: Floats, start: int, R: Floats, t: Floats, limit: float, values: Floats) -> None:
    """Write the truncated squared errors of a block of matches from ``start`` on; the limit for an outlier.

    The loop has no branch and no sum, so that the compiler treats several matches at once.
    """
    R00, R01, R02, R10, R11, R12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    R20, R21, R22, t0, t1, t2 = R[2, 0], R[2, 1], R[2, 2], t[0], t[1], t[2]
    for j in range(min(_BLOCK, rays.shape[1] - start)):
        i = start + j
        m0, m1, m2, n0, n1, n2 = rays[0, i], rays[1, i], rays[2, i], rays[3, i], rays[4, i], rays[5, i]
        a0, a1, a2 = R00 * m0 + R01 * m1 + R02 * m2, R10 * m0 + R11 * m1 + R12 * m2, R20 * m0 + R21 * m1 + R22 * m2
        p, s = a0 * t0 + a1 * t1 + a2 * t2, n0 * t0 + n1 * t1 + n2 * t2
        c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
        e = c0 * t0 + c1 * t1 + c2 * t2
        D = 2 - p * p - s * s - 2 * e * e
        r2 = e * e / (D if D > 1e-12 else 1e-12)
        cosine = a0 * n0 + a1 * n1 + a2 * n2
        behind = (c0 * c0 + c1 * c1 + c2 * c2 > 2 * limit) & ((cosine * s < p) | (s < cosine * p))
        values[j] = limit if behind | (r2 >= limit) else r2
