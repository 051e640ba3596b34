"""Tail probabilities of the risk: of errors in two and in three directions, and of a statistic that is tested often.

A window is evaluated at each frame, and the first one with a small risk is accepted. Two kinds of terms have to be
distinguished.

* **A posterior probability** is right at any time at which one stops. It is a conditional expectation of "the map is
  wrong", so that its mean over all accepted maps is the share of the wrong ones, whatever the rule of stopping
  (optional stopping). The same holds for a likelihood ratio: under the competing motion its mean is 1 at any time, so
  that it exceeds 1/p at any time with probability p at most (Ville's inequality).
* **The tail of a statistic** is no such probability. A statistic that is Gaussian at each look exceeds z at some look
  more often than at one. For a sum whose information grows by a factor G between the first look and the last,

      P(z is exceeded at any look) <= Q(z) (1 + max(z^2 - 1, 0) / 2 * ln G)

  up to terms of order 1/z^2 (Siegmund, "Sequential Analysis", 1985, chapter 4: the boundary of a constant significance
  level). :func:`at_any_time` is this bound.
"""

from __future__ import annotations

import math

import numpy as np

from quest.tails import gaussian_tail
from slam_init.types.arrays import Floats
from slam_init.window.levels import INFORMATION_GROWS


def two_directions(limit: float, sigmas: Floats) -> Floats:
    """Probability that an error in two directions exceeds a limit, by its largest standard deviation.

    Shapes: ``sigmas`` (S,), returns (S,).
    """
    return np.asarray(np.exp(-0.5 * (limit / np.maximum(sigmas, 1e-9)) ** 2))


def three_directions(limit: float, sigma: float) -> float:
    """The same in three directions: the tail of chi-square with three degrees of freedom."""
    z = limit / max(sigma, 1e-9)
    return math.erfc(z / math.sqrt(2)) + math.sqrt(2 / math.pi) * z * math.exp(-0.5 * z * z)


def chi_square_as_gaussian(mean_square: Floats, freedom: float) -> Floats:
    """Chi-square as standard deviations of a Gaussian: its cube root is nearly Gaussian (Wilson and Hilferty, 1931).

    Shapes: ``mean_square`` (N,) chi-square over its degrees of freedom, returns (N,).
    """
    spread = 2 / (9 * freedom)
    return np.asarray((mean_square ** (1 / 3) - (1 - spread)) / math.sqrt(spread))


def at_any_time(z: float) -> float:
    """Probability that a statistic exceeds z at any look, where a window is evaluated again while frames arrive."""
    return min(1.0, gaussian_tail(z) * (1 + 0.5 * max(z * z - 1, 0.0) * math.log(INFORMATION_GROWS)))
