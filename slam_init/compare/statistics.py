"""What may be concluded from counts and times: intervals, and tests on the same trials.

Everything here is in closed form: no resampling, no random draws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.types.arrays import Floats

__all__ = ["Interval", "holm", "mcnemar_exact", "restricted_mean", "wilson"]

#: Standard deviations of a two-sided 95 % interval of the normal distribution.
_Z95 = 1.959963984540054


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval; all three are NaN where nothing was observed."""

    value: float
    low: float
    high: float


def wilson(successes: int, trials: int) -> Interval:
    """Share of successes with the score interval of Wilson (1927), which holds for small counts and near 0 and 1.

    Raises
    ------
    ValueError
        Where the counts are negative or there are more successes than trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials: give counts with 0 <= successes <= trials")
    if trials == 0:
        return Interval(math.nan, math.nan, math.nan)
    share, z2 = successes / trials, _Z95**2
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = _Z95 * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    # At the ends the interval ends exactly there; rounding must not say otherwise.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return Interval(share, low, high)


def mcnemar_exact(only_first: int, only_second: int) -> float:
    """p-value of McNemar's exact test that two methods succeed equally often on the same trials.

    Parameters
    ----------
    only_first, only_second : int
        Trials in which one of the two succeeds and the other does not. Where both do the same, nothing is learned.

    Returns
    -------
    float
        Two-sided: how likely a fair coin is at least as one-sided. 1 where the methods never differ.
    """
    n, k = only_first + only_second, min(only_first, only_second)
    # Logarithms, as the binomial coefficients of thousands of trials overflow; good to ten digits.
    log_terms = np.array([-math.lgamma(i + 1) - math.lgamma(n - i + 1) for i in range(k + 1)])
    largest = float(log_terms.max())
    log_tail = largest + math.log(float(np.sum(np.exp(log_terms - largest))))
    return min(1.0, 2 * math.exp(log_tail + math.lgamma(n + 1) - n * math.log(2)))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values adjusted for their number (Holm 1979), in the given order."""
    order = np.argsort(np.asarray(p_values, float), kind="stable")
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(order.tolist()):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = largest
    return adjusted


def restricted_mean(times: Sequence[float | None] | Floats, limits: Sequence[float] | Floats) -> Interval:
    """Mean of ``min(time, limit)``: the restricted mean time, with the normal interval of a mean.

    Parameters
    ----------
    times : (N,) float or None
        None or NaN where it never happened: that trial counts as its limit.
    limits : (N,) float
        How long each trial was watched. With limits known in advance for every trial this mean is unbiased, whatever
        the distribution of the times.
    """
    at_most = np.asarray(limits, float)
    if len(at_most) == 0:
        return Interval(math.nan, math.nan, math.nan)
    observed = np.array([math.nan if time is None else time for time in times], float)
    values = np.fmin(observed, at_most)
    mean = float(values.mean())
    # A single trial says nothing about the spread.
    half = _Z95 * float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Interval(mean, mean - half, mean + half)
