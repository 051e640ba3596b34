"""Residuals of a pose, and its score: the truncated sum of squared residuals.

References
----------
.. [T00] P. H. S. Torr, A. Zisserman, "MLESAC", CVIU 2000 (the truncated cost, there MSAC).
.. [M05] J. Matas, O. Chum, "Randomized RANSAC with sequential probability ratio test", ICCV 2005.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.kernels.compiler import compiled
from quest.robust.kernels.small_algebra import rotation_of_model

__all__ = ["residuals", "residuals_of_model", "score", "score_or_refute"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A model is given up where the logarithm of the likelihood ratio falls below this value. One good model in a hundred
#: is given up.
_REFUTED = -4.6


@compiled
def _residual(m: Floats, n: Floats, i: int, R: Floats, t: Floats, flat: float) -> tuple[float, bool]:
    """Squared Sampson error of match i, and whether the match lies behind a camera beyond doubt.

    The sign of a depth is beyond doubt where the squared sine of the parallax exceeds ``flat``.
    """
    a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
    a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
    a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
    n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
    p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n0 * t[0] + n1 * t[1] + n2 * t[2]
    c0, c1, c2 = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
    e = c0 * t[0] + c1 * t[1] + c2 * t[2]
    r2 = e * e / max(2 - p * p - s * s - 2 * e * e, 1e-12)
    cosine = a0 * n0 + a1 * n1 + a2 * n2
    observable = c0 * c0 + c1 * c1 + c2 * c2 > flat
    return r2, observable and (cosine * s < p or s < cosine * p)


@compiled
def residuals(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float) -> tuple[Floats, Bools]:
    """Residuals of one pose, as :meth:`quest.robust.pose_problem.RelativePoseProblem.residuals`.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    R, t : (3, 3) float, (3,) float
        The pose.
    threshold_rad : float
        Sampson error above which a match is an outlier. Below a parallax of sqrt(2) times this angle the sign of a
        depth is left open.

    Returns
    -------
    r2 : (N,) float
        Squared Sampson errors, rad^2.
    behind : (N,) bool
        Whether a match lies behind a camera beyond doubt.
    """
    r2, behind = np.empty(len(m)), np.empty(len(m), np.bool_)
    for i in range(len(m)):
        r2[i], behind[i] = _residual(m, n, i, R, t, 2 * threshold_rad * threshold_rad)
    return r2, behind


@compiled
def residuals_of_model(m: Floats, n: Floats, model: Floats, threshold_rad: float) -> tuple[Floats, Bools]:
    """Residuals as :func:`residuals`, of a pose in one row.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    model : (7,) float
        (q_wxyz, t), unit norm each.
    threshold_rad : float
        See :func:`residuals`.

    Returns
    -------
    r2 : (N,) float
        Squared Sampson errors, rad^2.
    behind : (N,) bool
        Whether a match lies behind a camera beyond doubt.
    """
    r2, behind = residuals(m, n, rotation_of_model(model), model[4:], threshold_rad)
    return r2, behind


@compiled
def score(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, bail: float) -> tuple[float, int]:
    """Truncated sum of squared Sampson errors and number of inliers (MSAC [T00]_).

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    R, t : (3, 3) float, (3,) float
        The pose.
    threshold_rad : float
        Sampson error above which a match is an outlier.
    bail : float
        The loop stops once the sum exceeds this bound. No better pose is lost: the sum only grows.

    Returns
    -------
    cost : float
        The sum, rad^2; infinite where the loop stopped.
    inliers : int
        0 where the loop stopped.
    """
    cost, inliers, _ = score_or_refute(m, n, R, t, threshold_rad, bail, 0.0, 0.0)
    return cost, inliers


@compiled
def score_or_refute(
    m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, bail: float, good: float, bad: float
) -> tuple[float, int, float]:
    """Score as :func:`score`, and stop as well where the matches refute a good pose.

    The matches are a sequence of trials. A good pose explains each with probability ``good``, a bad one with
    probability ``bad``. The likelihood ratio of the two is followed (Wald's sequential test, for RANSAC [M05]_) where
    ``good`` is more than 1.5 times ``bad``.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2, in random order.
    R, t : (3, 3) float, (3,) float
        The pose.
    threshold_rad : float
        Sampson error above which a match is an outlier.
    bail : float
        See :func:`score`.
    good, bad : float
        Share of matches that a good pose and a bad pose explain; zero for no test.

    Returns
    -------
    cost : float
        The truncated sum, rad^2; infinite where the loop stopped.
    inliers : int
        0 where the loop stopped.
    share : float
        Share of inliers among the matches up to the end of the loop.
    """
    limit = threshold_rad * threshold_rad
    cost, inliers, evidence = 0.0, 0, 0.0
    tested = good > 1.5 * bad and bad > 0
    for_hit = np.log(good / bad) if tested else 0.0
    for_miss = np.log((1 - good) / (1 - bad)) if tested else 0.0
    for i in range(len(m)):
        r2, behind = _residual(m, n, i, R, t, 2 * limit)
        if r2 < limit and not behind:
            cost += r2
            inliers += 1
            evidence += for_hit
        else:
            cost += limit
            evidence += for_miss
            if cost > bail or evidence < _REFUTED:
                return np.inf, 0, inliers / (i + 1)
    return cost, inliers, inliers / len(m)
