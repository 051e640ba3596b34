"""Confidence intervals of counts and times, and paired tests of methods on the same trials.

The formulas are in closed form, except for :func:`cluster_mean`, which resamples with a fixed seed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_init.types.arrays import Bools, Floats

#: Half-width of the two-sided 95 % interval of the normal distribution, in standard deviations.
_Z95 = 1.959963984540054
#: Number of bootstrap samples. The random error of the ends of an interval is then about 1.5 % of its width (one
#: standard deviation, for normal means).
_BOOTSTRAP_SAMPLES = 2000
_BOOTSTRAP_SEED = 0
#: Number of random draws that are in memory at a time.
_DRAWS_AT_A_TIME = 2**20
#: All sign patterns are tried up to this number of clusters: 65,536 patterns.
_MAX_EXACT_CLUSTERS = 16
#: Drawn patterns for more clusters: the random error of a p-value of 0.05 is then 0.0015.
_SIGN_SAMPLES = 20_000


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval; all three values are NaN if there are no observations."""

    value: float
    #: low, high: Ends of the interval.
    low: float
    high: float


def wilson(successes: int, trials: int) -> Interval:
    """Share of successes with Wilson's score interval [W27]_.

    The interval is valid for small counts and for shares near 0 and 1.

    .. [W27] E. B. Wilson, Probable inference, the law of succession, and statistical inference, Journal of the American
       Statistical Association 22(158), 1927.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials: give counts with 0 <= successes <= trials")
    if trials == 0:
        return Interval(math.nan, math.nan, math.nan)
    share, z2 = successes / trials, _Z95**2
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = _Z95 * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    # For 0 successes the lower end is exactly 0, and for no failures the upper end is exactly 1; rounding is avoided.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return Interval(share, low, high)


def mcnemar_exact(only_first: int, only_second: int) -> float:
    """Compute the p-value of McNemar's exact test that two methods succeed equally often on the same trials [M47]_.

    .. [M47] Q. McNemar, Note on the sampling error of the difference between correlated proportions or percentages,
       Psychometrika 12(2), 1947.

    * ``only_first, only_second``: Number of trials in which only the first, and only the second, method succeeds.
      Trials in which both succeed or both fail do not enter the test.
    * Returns: Two-sided p-value: probability that tosses of a fair coin differ at least as much from half and half. 1
      if the methods never differ.
    """
    n, k = only_first + only_second, min(only_first, only_second)
    # Logarithms are used because the binomial coefficients of thousands of trials overflow. Accurate to ten digits.
    log_terms = np.array([-math.lgamma(i + 1) - math.lgamma(n - i + 1) for i in range(k + 1)])
    largest = float(log_terms.max())
    log_tail = largest + math.log(float(np.sum(np.exp(log_terms - largest))))
    return min(1.0, 2 * math.exp(log_tail + math.lgamma(n + 1) - n * math.log(2)))


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values for the number of tests by Holm's method [H79]_.

    .. [H79] S. Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6(2),
       1979.
    """
    order = np.argsort(np.asarray(p_values, float), kind="stable")
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(order.tolist()):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = largest
    return adjusted


def restricted_mean(times: Sequence[float | None] | Floats, limits: Sequence[float] | Floats) -> Interval:
    """Compute the restricted mean time, the mean of ``min(time, limit)``, with the normal interval of a mean.

    The limit of each trial is known in advance, so the mean is unbiased for any distribution of the times.

    Shapes: ``times`` (N,), ``limits`` (N,).

    * ``times``: Time of the event in each trial; None or NaN if the event did not happen. Such a trial counts as its
      limit.
    * Returns: In the unit of the times, from 0 to the mean limit. The ends are NaN for a single trial.
    """
    at_most = np.asarray(limits, float)
    if len(at_most) == 0:
        return Interval(math.nan, math.nan, math.nan)
    observed = np.array([math.nan if time is None else time for time in times], float)
    values = np.fmin(observed, at_most)
    mean = float(values.mean())
    # The spread is not known from a single trial.
    half = _Z95 * float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    if math.isnan(half):
        return Interval(mean, math.nan, math.nan)
    # No time is negative, and none is longer than its limit, but the normal interval of a few trials may reach there.
    return Interval(mean, max(mean - half, min(0.0, mean)), min(mean + half, max(float(at_most.mean()), mean)))


def cluster_mean(values: Floats, clusters: NDArray[np.object_]) -> Interval:
    """Compute a mean with the interval of a bootstrap over clusters [E93]_, for values that depend on one another.

    Each of 2000 samples draws as many clusters as there are, with replacement, and takes all values of these clusters.
    The interval spans the 2.5th and the 97.5th percentile of the means of the samples. It is too narrow for fewer than
    about ten clusters: few clusters cannot show how much clusters differ.

    .. [E93] B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, Chapman and Hall, 1993, chapters 8 and 13.

    Shapes: ``values`` (N,), ``clusters`` (N,).

    * ``clusters``: Name of the cluster of each value, for example the sequence of a trial.
    * Returns: In the unit of the values. The ends are NaN for a single cluster.
    """
    if len(values) == 0:
        return Interval(math.nan, math.nan, math.nan)
    names, index = np.unique(clusters.astype(str), return_inverse=True)
    count = len(names)
    sums, sizes = np.bincount(index, weights=values), np.bincount(index)
    mean = float(sums.sum()) / len(values)
    if count == 1:
        return Interval(mean, math.nan, math.nan)
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    block = max(1, _DRAWS_AT_A_TIME // count)
    means: list[Floats] = []
    for begin in range(0, _BOOTSTRAP_SAMPLES, block):
        drawn = rng.integers(count, size=(min(block, _BOOTSTRAP_SAMPLES - begin), count))
        means.append(sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1))
    low, high = np.quantile(np.concatenate(means), [0.025, 0.975])
    return Interval(mean, float(low), float(high))


def cluster_share(hits: Bools, clusters: NDArray[np.object_]) -> Interval:
    """Share of hits with an interval for trials that depend on one another within a cluster.

    If each cluster has one trial, the interval is Wilson's. Otherwise it is that of :func:`cluster_mean`. If all or no
    trials are hits, each bootstrap sample has the same share; the interval is then Wilson's with the number of clusters
    as the number of trials, which counts the trials of a cluster as one.

    Shapes: ``hits`` (N,), ``clusters`` (N,).
    """
    trials, count = len(hits), len(set(clusters.tolist()))
    found = int(np.sum(hits))
    if count == trials:
        return wilson(found, trials)
    if found in (0, trials):
        return wilson(count if found else 0, count)
    share = cluster_mean(hits.astype(float), clusters)
    if count == 1:
        return share
    return Interval(share.value, max(0.0, share.low), min(1.0, share.high))


def sign_flip(differences: Floats, clusters: NDArray[np.object_]) -> float:
    """Compute the p-value of a sign-flip test that paired differences have no preferred sign [F35]_.

    The differences of a cluster keep their relative signs, because they depend on one another. If each cluster has one
    difference of -1, 0 or 1, the test is McNemar's exact test.

    .. [F35] R. A. Fisher, The Design of Experiments, Oliver and Boyd, 1935, section 21.

    Shapes: ``differences`` (N,), ``clusters`` (N,).

    * ``differences``: Result of the first method minus that of the second one, trial by trial.
    * Returns: Two-sided p-value: share of the sign patterns whose sum is at least as far from zero. All patterns are
      tried for up to 16 clusters that differ; otherwise 20,000 drawn ones, with a fixed seed.
    """
    _, index = np.unique(clusters.astype(str), return_inverse=True)
    sums = np.bincount(index, weights=differences) if len(differences) else np.zeros(0)
    sums = sums[sums != 0]
    if len(sums) == 0:
        return 1.0
    least = abs(float(sums.sum())) - 1e-9
    if len(sums) <= _MAX_EXACT_CLUSTERS:
        patterns = np.arange(2 ** len(sums))[:, None] >> np.arange(len(sums)) & 1
        return float(np.mean(np.abs((2 * patterns - 1) @ sums) >= least))
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    farther, block = 0, max(1, _DRAWS_AT_A_TIME // len(sums))
    for begin in range(0, _SIGN_SAMPLES, block):
        signs = 2 * rng.integers(2, size=(min(block, _SIGN_SAMPLES - begin), len(sums))) - 1
        farther += int(np.sum(np.abs(signs @ sums) >= least))
    return (1 + farther) / (1 + _SIGN_SAMPLES)
