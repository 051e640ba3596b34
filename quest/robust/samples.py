"""Samples of RANSAC: how they are drawn, how many are needed, and what a search reports."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RansacReport:
    """The models that the loop found.

    Attributes
    ----------
    models : (k, P) float
        The best refined model first, then the best raw models of other samples, by cost.
    costs : (k,) float
        Cost of each model.
    samples : int
        Number of samples drawn.
    """

    models: Floats
    costs: Floats
    samples: int


def samples_needed(inlier_share: float, sample_size: int, confidence: float, yield_per_sample: float) -> float:
    """Number of samples among which a good one is with the given confidence.

    Parameters
    ----------
    inlier_share : float
        Share of the data that the best model explains.
    sample_size : int
        Number of data in a sample.
    confidence : float
        Between 0 and 1.
    yield_per_sample : float
        Probability that a sample without outliers leads to the model after refinement; below 1 because of noise.

    Returns
    -------
    float
        At least 1; infinite where no sample is likely to be good.
    """
    good = yield_per_sample * inlier_share**sample_size
    if good >= 1:
        return 1.0
    return math.inf if good < 1e-15 else math.log(1 - confidence) / math.log1p(-good)


def draw_samples(rng: np.random.Generator, count: int, size: int, batch: int) -> Ints:
    """Draw samples uniformly from all subsets of ``range(count)``.

    Parameters
    ----------
    rng : numpy.random.Generator
    count : int
        Number of data.
    size : int
        Number of data in a sample.
    batch : int
        Number of samples.

    Returns
    -------
    (batch, size) int
        Indices, distinct within each row.
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
