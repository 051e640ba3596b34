"""Samples of RANSAC: how many are needed, and their choice: uniform, or from a growing subset of the best matches.

References
----------
.. [C05] O. Chum, J. Matas, "Matching with PROSAC: progressive sample consensus", CVPR 2005.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: After this number of samples at the latest PROSAC draws from all data, as its authors propose.
_PROSAC_SAMPLES = 200_000


def samples_needed(inlier_share: float, sample_size: int, confidence: float, yield_per_sample: float) -> float:
    """Number of samples among which a good one is with the given confidence.

    * ``yield_per_sample``: Probability that a sample without outliers leads to the model after refinement; below 1
      because of noise.
    """
    good = yield_per_sample * inlier_share**sample_size
    if good >= 1:
        return 1.0
    return math.inf if good < 1e-15 else math.log(1 - confidence) / math.log1p(-good)


def draw_samples(rng: np.random.Generator, count: int, size: int, batch: int) -> Ints:
    """Draw samples uniformly from all subsets of ``range(count)``.

    Shapes: returns (batch, size).
    """
    if count <= 4 * size:  # few data: rejection would take long, a full shuffle is cheap
        return np.argsort(rng.random((batch, count)), axis=1)[:, :size]
    samples = rng.integers(count, size=(batch, size))
    while True:
        ordered = np.sort(samples, axis=1)
        repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
        if not repeated.any():
            return samples
        samples[repeated] = rng.integers(count, size=(int(repeated.sum()), size))


def progressive_samples(rng: np.random.Generator, count: int, size: int, sampled: int, batch: int) -> Ints:
    """Draw the samples number ``sampled`` to ``sampled + batch`` of PROSAC [C05]_.

    Samples come from a growing subset of the best matches. Each sample holds the newest match of the subset and others
    of the subset.

    Shapes: returns (batch, size).
    """
    ends = _growth(count, size)
    newest = np.searchsorted(ends, np.arange(sampled, sampled + batch), side="right") + size - 1
    samples = np.empty((batch, size), np.int64)
    uniform = newest >= count
    samples[uniform] = draw_samples(rng, count, size, int(uniform.sum()))
    last = newest[~uniform]
    progressive = np.empty((len(last), size), np.int64)
    progressive[:, 0] = last
    # Floyd's method for a random subset of the ranks below: the end of the range replaces a number sampled before.
    for k in range(1, size):
        end = last - size + k
        number = rng.integers(end + 1)
        known = (progressive[:, 1:k] == number[:, None]).any(axis=1)
        progressive[:, k] = np.where(known, end, number)
    samples[~uniform] = progressive
    return samples


def subset_size(count: int, size: int, sampled: int) -> int:
    """Size of the PROSAC subset after ``sampled`` samples."""
    return min(int(np.searchsorted(_growth(count, size), sampled - 1, side="right")) + size, count)


def _growth(count: int, size: int) -> Floats:
    """Numbers of samples after which the subset has size + 1, size + 2, ... count matches: T_g, eq. 3 of [C05]_."""
    grown = np.arange(size, count + 1)
    log_share = np.zeros(len(grown))
    for k in range(size):
        log_share += np.log((grown - k) / (count - k))
    steps = np.maximum(np.ceil(np.diff(_PROSAC_SAMPLES * np.exp(log_share), prepend=0.0)), 1.0)
    return np.asarray(np.cumsum(steps))
