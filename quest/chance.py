"""Whether a motion explains more matches than chance would: an a-contrario test over all gates and all samples.

Under the null hypothesis the matches are random: any two rays may be partners. A motion that was not fitted to a match
then explains it, within a gate e, with the probability p(e). Shuffles of the matches measure p. The motion was chosen
to explain many matches, and the gate is chosen afterwards, so the test counts all of them. N matches have C(N, 5)
samples, each with s motions in the mean. The expected number of these motions that explain k or more matches within one
of G gates is at most [M04]_ ::

    F = min over the gates of   G . s . C(N, 5) . P(Binomial(N - 5, p(e)) >= k(e) - 5)

A rotation is fitted to two matches, its p grows with the square of the gate, and a sample has one rotation.

A moving object, or one patch of a repeated texture, turns as a rotation does, and it is no chance. So a rotation has
to explain more matches than chance would outside each patch of the view, too. One match outside may be fitted: the
patch leaves the turn about itself open. Where no rotation counts, a motion has to explain more than chance would of the
matches that the best rotation leaves, too.

References
----------
.. [M04] L. Moisan, B. Stival, "A probabilistic criterion to detect rigid point matches between two images and estimate
   the fundamental matrix", IJCV 57, 2004.
"""

from __future__ import annotations

from itertools import repeat
from math import exp, lgamma, log, log1p, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels
from quest.robust.pose_problem import PoseProblem
from quest.robust.spatial_blocks import directions_of, percentiles

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Gates of the test: the threshold times these shares. The least is the least noise, see quest.noise.refine_with_noise.
_GATES, _GATES2 = 0.5 ** np.arange(10.0), 0.25 ** np.arange(10.0)
#: Matches that fix a motion, and the mean number of motions with all five random points in front of both cameras.
_OF_MOTION, _MOTIONS = 5, 2
#: Matches that fix a rotation, matches outside a patch that fix the turn about the patch, and those that fix this turn
#: and the direction of a motion.
_OF_ROTATION, _OF_TURN, _OF_DIRECTION = 2, 1, 3
#: Expected number by chance up to which a motion counts, and up to which a rotation counts. F bounds the number among
#: all samples, of which a search tries a small part: the least F of 2,000 searches among random matches was 3.4. A
#: search for a rotation tries most pairs.
LARGEST_OF_MOTION, LARGEST_OF_ROTATION = 0.1, 1e-3
#: Number of shuffled matches, for an error of a fifth where one in 40 is explained by chance; the least number of
#: shuffles; and the largest number of shuffled matches, for an error of an eighth.
_SHUFFLED_MATCHES, _LEAST_SHUFFLES, _MOST_SHUFFLED = 1000, 3, 3000
#: The gate by which p is measured where a rotation is tested, in thresholds: within one threshold a rotation explains
#: one random match in several thousand.
_WIDE = 8.0
#: Radius of a patch, as a share of the diagonal of the view; the disc fills a quarter of the view. Number of inliers at
#: which the patch is tried.
_PATCH, _CENTRES = 0.2, 100


class Chance(NamedTuple):
    """What chance explains of the matches."""

    #: Mean number of matches that the motion explains, within the gate, after the matches are shuffled. In a shuffle no
    #: match keeps its partner: one that did would be no random match. Half a match counts where none is explained: a
    #: mean of zero would say that chance explains nothing.
    inliers: float
    #: Expected number of motions that explain as many random matches.
    false_alarms: float
    #: Share of random matches that the motion explains within each of the gates of the test.
    shares: Floats


def chance_of_motion(problem: PoseProblem, model: Floats, gate_rad: float, rng: np.random.Generator) -> Chance:
    """What chance explains of the matches, by shuffles: what a wrong motion reaches on these very matches.

    Shapes: ``model`` (7,).
    """
    total, threshold_rad = len(problem), problem.threshold_rad
    trials = _trials(total)
    order = rng.permutation(total)
    m, n = problem.m[order], problem.n[order]
    explained, loosely = kernels.chance_inliers(m, n, model, threshold_rad, gate_rad, trials)
    counts = _counts(problem.residuals(model), threshold_rad)
    tests = log(len(_GATES) * _MOTIONS) + log_binomial(total, _OF_MOTION)
    share = np.asarray(upper_share(loosely, trials) * _GATES)
    return Chance(max(explained, 0.5) * total / trials, false_alarms(counts, total, _OF_MOTION, tests, share), share)


def false_alarms_beside_rotation(problem: PoseProblem, model: Floats, turned_r2: Floats, shares: Floats) -> float:
    """Expected number of directions that explain by chance as many of the matches that a rotation does not explain.

    Shapes: ``model`` (7,), ``turned_r2`` (N,), ``shares`` (G,).

    * ``turned_r2``: Squared residuals of the rotation. What it explains may be a patch, or the far points of a scene.
    """
    r2 = problem.residuals(model)
    rest = turned_r2 >= 2 * problem.threshold_rad**2
    count = int(np.count_nonzero(rest))
    tests = log(len(_GATES) * _MOTIONS) + log_binomial(count, _OF_DIRECTION)
    return false_alarms(_counts(r2[rest], problem.threshold_rad), count, _OF_DIRECTION, tests, shares)


def _trials(total: int) -> int:
    """Number of shuffled matches: at least one shuffle, and three where there are at most 1000 matches."""
    trials = max(_LEAST_SHUFFLES, -(-_SHUFFLED_MATCHES // total)) * total
    return max(total, min(trials, _MOST_SHUFFLED))


def false_alarms_of_rotation(
    problem: PoseProblem, R: Floats, inliers: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[float, float]:
    """Expected numbers of rotations that explain as many random matches as a rotation does: anywhere, and off a patch.

    Shapes: ``R`` (3, 3), ``inliers`` (N,).

    * ``inliers``: The matches that the rotation explains; they show where the patch is.
    """
    total, threshold_rad = len(problem), problem.threshold_rad
    # One component of the residual has the size of a Sampson error.
    turned, half = problem.m @ R.T, 0.5
    r2 = half * np.sum((problem.n - turned) ** 2, axis=1)
    explained, shuffles = 0, max(1, min(total - 1, _trials(total) // total))
    order = rng.permutation(total)
    n, turned = np.tile(problem.n[order], (2, 1)), turned[order]
    for shuffle in range(1, shuffles + 1):
        wrong = half * np.sum((n[total - shuffle : 2 * total - shuffle] - turned) ** 2, axis=1)
        explained += int(np.count_nonzero(wrong < (_WIDE * threshold_rad) ** 2))
    share = np.asarray(upper_share(explained, shuffles * total) / _WIDE**2 * _GATES2)
    tests = log(len(_GATES)) + log_binomial(total, _OF_ROTATION)
    everywhere = false_alarms(_counts(r2, threshold_rad), total, _OF_ROTATION, tests, share)
    outside = ~_largest_patch(directions_of(problem.m), inliers)
    count = int(outside.sum())
    tests = log(len(_GATES)) + log_binomial(count, _OF_TURN)
    return everywhere, false_alarms(_counts(r2[outside], threshold_rad), count, _OF_TURN, tests, share)


def log_binomial(n: int, k: int) -> float:
    """Logarithm of the number of subsets of k of n; zero where there is none."""
    return lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1) if n >= k else 0.0


def _counts(r2: Floats, threshold_rad: float) -> Ints:
    """Number of squared residuals within each gate."""
    return np.sort(r2).searchsorted(threshold_rad**2 * _GATES2)


def upper_share(explained: int, trials: int) -> float:
    """Share of random matches that is explained, one standard deviation above the measured one."""
    return min(1.0, (explained + sqrt(explained) + 1) / trials)


def false_alarms(counts: Ints, total: int, fitted: int, tests: float, share: Floats) -> float:
    """The F of the module docstring, from the counts within the gates; ``tests`` is the logarithm of their number."""
    others = total - fitted
    if others <= 0:
        return float("inf")
    least = min(map(_log_tail, (counts - fitted).tolist(), repeat(others), share.tolist()))
    return exp(min(tests + least, 700.0))


def _log_tail(count: int, trials: int, p: float) -> float:
    """Logarithm of a bound on the probability of ``count`` or more hits in a number of trials."""
    if count <= trials * p:
        return 0.0
    term = log_binomial(trials, count) + count * log(p) + (trials - count) * log1p(-p)
    # Each term is smaller than the one before by this factor at least: a geometric series.
    ratio = (trials - count) * p / ((count + 1) * (1 - p))
    return min(0.0, term - log1p(-ratio))


def _largest_patch(where: Floats, inliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The matches at places (N, 2) in the disc about an inlier that holds most inliers."""
    low, high = percentiles(where)
    radius2 = (_PATCH**2) * float(np.sum((high - low) ** 2))
    centres = where[inliers]
    if len(centres) == 0:
        return np.zeros(len(where), bool)
    some = centres[:: max(1, len(centres) // _CENTRES)]
    held = [np.count_nonzero(np.sum((centres - centre) ** 2, axis=1) <= radius2) for centre in some]
    return np.asarray(np.sum((where - some[int(np.argmax(held))]) ** 2, axis=1) <= radius2)
