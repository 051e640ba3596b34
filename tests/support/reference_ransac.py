"""Locally optimized RANSAC that knows no geometry, and the relative pose as its problem.

The compiled search is compared with it. A :class:`Problem` defines the size of a sample, the models that a batch of
samples proposes, the cost of a model on all data, and the refinement of a model. The tests run the loop on a
line-fitting problem as well.

References
----------
.. [1] M. A. Fischler, R. C. Bolles, "Random sample consensus", CACM 1981.
.. [2] O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC", DAGM 2003.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix
from quest.geometry.refine import refine_pose
from quest.robust.samples import RansacReport, draw_samples, samples_needed
from quest.solvers.quest6 import quest6
from quest.solvers.quest7 import quest7
from quest.solvers.selection import select_candidates

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: The batches grow: easy data stop after the first small batch, hard data need few large batches.
_BATCHES = (16, 32, 64)


class Problem(Protocol):
    """A model and its data, as the loop sees them."""

    #: Number of data in a sample.
    sample_size: int

    def __len__(self) -> int:
        """Number of data."""
        ...

    def solve(self, samples: Ints) -> Floats:
        """The models that a batch of samples proposes.

        Shapes: ``samples`` (B, sample_size), returns (H, P).
        """
        ...

    def costs(self, models: Floats) -> tuple[Floats, Ints]:
        """Cost and number of inliers of each model on all data.

        Shapes: ``models`` (H, P), returns ``costs`` (H,), returns ``inliers`` (H,).
        """
        ...

    def polish(self, model: Floats) -> Floats:
        """Refine a model on its inliers.

        Shapes: ``model`` (P,), returns (P,).
        """
        ...


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

    * ``confidence``: Probability that the best model is found, given its share of inliers.
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
                    best, best_cost, best_inliers = (polished, float(polished_cost[0]), int(polished_inliers[0]))
        needed = samples_needed(best_inliers / count, size, confidence, yield_per_sample)
        if drawn >= max(min_samples, needed):
            break
    if best is None:
        return None
    all_models, all_costs = np.concatenate(models), np.concatenate(costs)
    order = np.argsort(all_costs, kind="stable")[: pool - 1]
    return RansacReport(
        np.concatenate([best[None], all_models[order]]), np.concatenate([[best_cost], all_costs[order]]), drawn
    )


class Sampler(NamedTuple):
    """A solver that proposes motions, and the number of matches that it takes."""

    #: Number of matches in a sample.
    size: int
    #: ``candidates(m, n)``: quaternions (B, K, 4) of samples (B, size, 3).
    candidates: Callable[[Floats, Floats], Floats]


#: The solvers that :func:`ransac` may run. QuEst 6 solves one of its three eigenproblems: the other
#: two triple its time and save less than that in samples.
SAMPLERS = {"quest6": Sampler(6, lambda m, n: quest6(m, n, lambdas="x")), "quest7": Sampler(7, quest7)}


class RelativePoseProblem:
    """Matched bearings as a :class:`Problem`.

    * ``m, n``: (N, 3) Unit bearings in camera 1 and camera 2.
    * ``threshold_rad``: Sampson error above which a match is an outlier.
    * ``solver``: A key of :data:`SAMPLERS`.
    """

    def __init__(self, m: Floats, n: Floats, threshold_rad: float, solver: str = "quest6") -> None:
        self.m, self.n, self.threshold_rad, self.loss = m, n, threshold_rad, "mixture"
        self._sampler = SAMPLERS[solver]
        self.sample_size = self._sampler.size

    def __len__(self) -> int:
        return len(self.m)

    def solve(self, samples: Ints) -> Floats:
        """The models that samples propose: the best four candidates of each sample.

        Shapes: ``samples`` (B, sample_size), returns (H, 7).
        """
        m, n = self.m[samples], self.n[samples]
        q, t = select_candidates(self._sampler.candidates(m, n), m, n)
        models = np.concatenate([q, t], axis=-1).reshape(-1, 7)
        return np.asarray(models[np.isfinite(models).all(axis=1)])

    def residuals(self, models: Floats) -> tuple[Floats, Bools]:
        """Residuals of all matches under each model.

        Shapes: ``models`` (H, 7), returns ``r2`` (H, N), returns ``behind`` (H, N).
        """
        R = matrix_from_quaternion(models[:, :4])
        t = models[:, 4:]
        zero = np.zeros(len(t))
        tx = np.stack(
            [
                np.stack([zero, -t[:, 2], t[:, 1]], axis=1),
                np.stack([t[:, 2], zero, -t[:, 0]], axis=1),
                np.stack([-t[:, 1], t[:, 0], zero], axis=1),
            ],
            axis=1,
        )
        # The products n_a m_b of every match: n . E m and n . R m of all hypotheses are then two matrix products.
        outer = (self.n[:, :, None] * self.m[:, None, :]).reshape(-1, 9).T
        e = (tx @ R).reshape(-1, 9) @ outer
        c = R.reshape(-1, 9) @ outer  # cosine of the parallax
        p = np.einsum("hi,hij->hj", t, R) @ self.m.T  # t . R m
        s = t @ self.n.T
        e2 = e * e
        r2 = e2 / np.maximum(2 - p * p - s * s - 2 * e2, 1e-12)
        # The depths have the signs of c s - p and s - c p. A parallax below the noise leaves these signs open: the
        # angle between two noisy rays of a distant point has sqrt(2) times the standard deviation of one ray.
        observable = 1 - c * c > 2 * self.threshold_rad**2
        behind = observable & ((c * s < p) | (s < c * p))
        return r2, behind

    def costs(self, models: Floats) -> tuple[Floats, Ints]:
        """Truncated sums of squared Sampson errors, and numbers of inliers.

        Shapes: ``models`` (H, 7), returns ``costs`` (H,), returns ``inliers`` (H,).
        """
        r2, behind = self.residuals(models)
        limit = self.threshold_rad**2
        r2[behind] = limit
        return np.minimum(r2, limit).sum(axis=1), (r2 < limit).sum(axis=1)

    def explained(self, model: Floats, gate_rad: float) -> Bools:
        """Whether each match lies within the gate and in front of both cameras.

        Shapes: ``model`` (7,), returns (N,).
        """
        r2, behind = self.residuals(model[None])
        return np.asarray((r2[0] < gate_rad**2) & ~behind[0])

    def polish(self, model: Floats) -> Floats:
        """Refine a model on the matches near it.

        Shapes: ``model`` (7,), returns (7,).
        """
        r2, behind = self.residuals(model[None])
        # Twice the threshold: a model from six noisy matches misses many of its own inliers by a little.
        near = (r2[0] < (2 * self.threshold_rad) ** 2) & ~behind[0]
        return self.refine(model, near, 0.5 * self.threshold_rad) if near.sum() >= 6 else model

    def refine(self, model: Floats, use: Bools, scale_rad: float) -> Floats:
        """Refine a model on given matches, see :func:`quest.geometry.refine.refine_pose`.

        Shapes: ``model`` (7,), ``use`` (N,), returns (7,).
        """
        R, t = refine_pose(matrix_from_quaternion(model[:4]), model[4:], self.m[use], self.n[use], scale_rad)
        return np.concatenate([quaternion_from_matrix(R), t])
