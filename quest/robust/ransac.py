"""Locally optimized RANSAC without any geometry.

A :class:`Problem` defines the size of a sample, the models that a batch of samples proposes, the cost of a model on all
data, and the refinement of a model. The loop draws samples, compares models, refines the best and decides when to stop.
The tests run it on a line-fitting problem.

References
----------
.. [1] M. A. Fischler, R. C. Bolles, "Random sample consensus", CACM 1981.
.. [2] O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC", DAGM 2003.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Problem", "RansacReport", "draw_samples", "ransac", "samples_needed"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: The batches grow: easy data stop after the first small batch, hard data need few large batches.
_BATCHES = (16, 32, 64)


class Problem(Protocol):
    """A model and its data, as the loop sees them.

    Attributes
    ----------
    sample_size : int
        Number of data in a sample.
    """

    sample_size: int

    def __len__(self) -> int:
        """Number of data."""
        ...

    def solve(self, samples: Ints) -> Floats:
        """The models that a batch of samples proposes.

        Parameters
        ----------
        samples : (B, sample_size) int
            Indices of data.

        Returns
        -------
        (H, P) float
            Finite rows only.
        """
        ...

    def costs(self, models: Floats) -> tuple[Floats, Ints]:
        """Cost and number of inliers of each model on all data.

        Parameters
        ----------
        models : (H, P) float

        Returns
        -------
        costs : (H,) float
            Lower is better.
        inliers : (H,) int
            Number of data that the model explains.
        """
        ...

    def polish(self, model: Floats) -> Floats:
        """Refine a model on its inliers.

        Parameters
        ----------
        model : (P,) float

        Returns
        -------
        (P,) float
        """
        ...


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


def ransac(
    problem: Problem,
    rng: np.random.Generator,
    *,
    confidence: float = 0.9999,
    min_samples: int = 32,
    max_samples: int = 2000,
    yield_per_sample: float = 0.5,
    pool: int = 8,
) -> RansacReport | None:
    """Search for the model of least cost.

    Parameters
    ----------
    problem : Problem
    rng : numpy.random.Generator
        The only source of randomness.
    confidence : float
        Probability that the best model is found, given its share of inliers.
    min_samples, max_samples : int
        Bounds on the number of samples.
    yield_per_sample : float
        See :func:`samples_needed`.
    pool : int
        Largest number of models to report.

    Returns
    -------
    RansacReport or None
        None where no sample proposed any model.
    """
    count, size = len(problem), problem.sample_size
    if count < size:
        return None
    best: Floats | None = None
    best_cost, best_inliers = math.inf, 0
    models: list[Floats] = []
    costs: list[Floats] = []
    drawn = 0
    batches = iter(_BATCHES)
    batch = _BATCHES[0]
    while drawn < max_samples:
        batch = min(next(batches, batch), max_samples - drawn)
        proposed = problem.solve(draw_samples(rng, count, size, batch))
        drawn += batch
        if len(proposed):
            cost, _ = problem.costs(proposed)
            order = np.argsort(cost, kind="stable")[:pool]
            models.append(proposed[order])
            costs.append(cost[order])
            # A raw model from noisy minimal data is worse than the same model refined, so a near miss is refined too.
            if cost[order[0]] < 1.1 * best_cost:
                polished = problem.polish(proposed[order[0]])
                polished_cost, polished_inliers = problem.costs(polished[None])
                if polished_cost[0] < best_cost:
                    best, best_cost, best_inliers = (
                        polished,
                        float(polished_cost[0]),
                        int(polished_inliers[0]),
                    )
        needed = samples_needed(best_inliers / count, size, confidence, yield_per_sample)
        if drawn >= max(min_samples, needed):
            break
    if best is None:
        return None
    all_models, all_costs = np.concatenate(models), np.concatenate(costs)
    order = np.argsort(all_costs, kind="stable")[: pool - 1]
    return RansacReport(
        np.concatenate([best[None], all_models[order]]),
        np.concatenate([[best_cost], all_costs[order]]),
        drawn,
    )
