"""Tail probabilities of the Gaussian and of the Poisson distribution."""

from __future__ import annotations

from math import erfc, exp, lgamma, log, sqrt


def gaussian_tail(z: float) -> float:
    """Probability that a standard normal variable exceeds z."""
    return 0.5 * erfc(z / sqrt(2))


def poisson_tail(count: int, mean: float) -> float:
    """Probability that a Poisson variable is at least ``count``, as the sum of its terms."""
    if count <= 0:
        return 1.0
    if mean == 0:
        return 0.0
    # The smaller of the two tails is summed, from its largest term outwards.
    if count > mean:
        term = total = exp(count * log(mean) - mean - lgamma(count + 1))
        k = count
        while term > 1e-14 * total:
            k += 1
            term *= mean / k
            total += term
        return total
    term = below = exp((count - 1) * log(mean) - mean - lgamma(count))
    for k in range(count - 1, 0, -1):
        term *= k / mean
        below += term
    return max(0.0, 1 - below)
