"""Samples of RANSAC: how they are chosen, how many are needed, and what a search reports."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RansacReport:
    """The models that the loop found."""

    #: (k, P) The best refined model first, then the best models of other samples, by cost.
    models: Floats
    #: (k,) Cost of each model, before it was refined but for the best one.
    costs: Floats
    #: Number of samples.
    samples: int
    #: Number of models, from the first, that are refined; the others are raw.
    refined: int = 1


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
