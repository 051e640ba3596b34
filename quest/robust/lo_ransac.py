"""The search for the motion that explains most matches: locally optimized RANSAC.

numpy draws the samples in chunks. The compiled loops of :mod:`quest.robust.kernels` solve and score them. The best
model of each chunk is refined on its inliers.

References
----------
.. [1] O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC", DAGM 2003.
.. [2] P. H. S. Torr, A. Zisserman, "MLESAC", CVIU 2000 (the truncated cost, there MSAC).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quest.robust import kernels
from quest.robust.pose_problem import PoseProblem
from quest.robust.samples import progressive_samples, samples_needed, subset_size

if TYPE_CHECKING:
    from quest.robust.kernels.samples import Pool

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


#: The chunks grow: easy data stop after the first chunk, hard data need few calls. With 48 in place of 24 the AUC of
#: 400 real pairs is the same (differences of .1 +- .3 %), and an estimate takes .15 ms longer.
_FIRST_CHUNK, _LARGEST_CHUNK = 24, 1024
#: Number of modes in the pool: at most three alternatives are reported, and several modes may be refined into one.
#: Number of modes beside the best one, and of refits, that are refined in the end.
_POOL, _RUNNERS_UP = 8, 2
#: Number of subsets of the inliers that the result is refitted to in the end, and their size. Fourteen matches
#: determine the five unknowns better than five matches do, and leave out the matches that hold the result in a local
#: optimum.
_REFITS, _REFIT_SIZE = 20, 14
#: Number of matches that a model is refined on in the search. The pose of 500 matches differs from that of all matches
#: by less than the modes of the search differ, and all inliers refine the result afterwards.
_MOST_NEAR = 500
#: Number of matches by which the refits are compared: a difference of a few inliers among them decides nothing.
_MOST_COMPARED = 1000
#: Stages of a refinement in the search: the largest Sampson error and the scale of the kernel, in thresholds. A model
#: from few noisy matches misses many of its own inliers by a little, so the first gate is twice the threshold.
_STAGES = np.array([(2.0, 0.3), (1.0, 0.15)])
#: Largest number of steps of each stage; the result is refined to the end afterwards.
_STEPS = 6
#: Smallest number of inliers among the best-scored matches that is no chance: those of the sample, and four or five
#: others.
_LEAST_DRAWN_INLIERS = 10


class Options(NamedTuple):
    """The checked arguments of :func:`quest.estimate_relative_pose` beside the bearings."""

    threshold_rad: float
    seed: int
    confidence: float
    max_samples: int
    scores: Floats | None


class RansacReport(NamedTuple):
    """The models that a search found."""

    #: (k, 7) Rows (q_wxyz, t): the refined best model, then the best model of each mode by cost, refined where it is
    #: near the best.
    models: Floats
    #: (k,) Cost of each model, before it was refined but for the best one.
    costs: Floats
    #: Number of samples.
    samples: int


class _Refined(NamedTuple):
    """A refined motion (q_wxyz, t), its truncated cost on all matches, and its number of inliers."""

    model: Floats
    cost: float
    inliers: int


class Proposer(NamedTuple):
    """What proposes motions.

    * ``sample``: Number of matches in a sample.
    * ``yield_``: Share of the samples without outliers that lead to the motion after refinement.
    * ``propose``: Enters the motions of samples (S, sample) of the matches m, n (N, 3) into a pool, by a threshold in
      radians: ``propose(m, n, samples, threshold_rad, pool)``.
    """

    sample: int
    yield_: float
    propose: Callable[[Floats, Floats, Ints, float, Pool], None]


def _propose_by_five(m: Floats, n: Floats, samples: Ints, threshold_rad: float, pool: Pool) -> None:
    kernels.try_samples_of_five(m, n, samples, threshold_rad, pool)


#: QuEst 5. The share is 0.24 to 0.82 under noise of 0.7 px at a focal length of 458 px, over general and planar scenes
#: with baselines from 0.03 to 0.5 of the depth.
QUEST_FIVE = Proposer(5, 0.55, _propose_by_five)


class _Matches(PoseProblem):
    """Matches in random order; ``by_score`` are their rows from the best score to the worst."""

    def __init__(self, m: Floats, n: Floats, options: Options, rng: np.random.Generator) -> None:
        # Matches often come sorted (by image row, by quality). The early stop of the scoring loop needs a random order.
        order = rng.permutation(len(m))
        super().__init__(m[order], n[order], options.threshold_rad)
        self.by_score = None if options.scores is None else np.argsort(-options.scores[order], kind="stable")

    def draw(self, rng: np.random.Generator, size: int, sampled: int, batch: int) -> Ints:
        """Samples (batch, size)."""
        if self.by_score is None:
            return kernels.draw_subsets(rng.random((batch, size)), len(self.m))
        return self.by_score[progressive_samples(rng, len(self.m), size, sampled, batch)]


def _empty_pool() -> Pool:
    return np.zeros((_POOL, 3, 3)), np.zeros((_POOL, 3)), np.full(_POOL, np.inf), np.zeros(_POOL, np.int64), np.zeros(2)


def lo_ransac(
    m: Floats,
    n: Floats,
    options: Options,
    rng: np.random.Generator,
    start: tuple[Floats, Floats] | None = None,
    proposer: Proposer = QUEST_FIVE,
) -> RansacReport | None:
    """Search for the motion of least truncated cost.

    See [1]_ and [2]_ of the module docstring; with scores the order of the samples is that of PROSAC.

    Shapes: ``m, n`` (N, 3).

    * ``m, n``: Unit bearings in camera 1 and camera 2, N at least the size of a sample.
    * ``start``: A pose (R, t) to begin with: samples are taken until a better one would have been found.
    * Returns: None where no sample has a solution.
    """
    threshold_rad, max_samples = options.threshold_rad, options.max_samples
    matches = _Matches(m, n, options, rng)
    pool = _empty_pool()
    pool_R, pool_t, costs, _, _ = pool
    best: _Refined | None = None if start is None else _polish(matches, kernels.model_of_pose(*start))
    leader: _Refined | None = None
    leading_cost = math.inf
    sampled, chunk = 0, _FIRST_CHUNK
    while sampled < max_samples:
        chunk = min(chunk, max_samples - sampled)
        samples = matches.draw(rng, proposer.sample, sampled, chunk)
        proposer.propose(matches.m, matches.n, samples, threshold_rad, pool)
        sampled += chunk
        # A raw model from few noisy matches is worse than the same model refined, so each new leader is refined.
        if costs[0] < leading_cost:
            leading_cost = costs[0]
            leader = _polish(matches, kernels.model_of_pose(pool_R[0], pool_t[0]))
            if best is None or leader.cost < best.cost:
                best = leader
        share = 0.0 if best is None else best.inliers / len(m)
        if matches.by_score is not None and best is not None:
            # The samples so far came from the best-scored matches, and the share of inliers is higher among those.
            sampled_from = matches.by_score[: subset_size(len(m), proposer.sample, sampled)]
            share = max(share, _share_of_rows(matches, best, sampled_from))
        needed = samples_needed(share, proposer.sample, options.confidence, proposer.yield_)
        if sampled >= needed:
            break
        chunk = min(2 * chunk, _LARGEST_CHUNK, max(_FIRST_CHUNK, math.ceil(min(needed, max_samples)) - sampled))
    if best is None:
        return None
    found = int(np.isfinite(costs).sum())
    models = np.empty((found, 7))
    for k in range(found):
        models[k] = kernels.model_of_pose(pool_R[k], pool_t[k])
    if leader is not None:
        models[0] = leader.model
    # A mode whose raw model misses half of the inliers is not beside the best optimum.
    near = int((costs[:found] < costs[0] + 0.5 * best.inliers * threshold_rad**2).sum())
    # The noise of a sample may lead to a model beside the best optimum, which refinement takes to a local one.
    for k in range(1, min(near, 1 + _RUNNERS_UP)):
        other = _polish(matches, models[k])
        models[k] = other.model
        if other.cost < best.cost:
            best = other
    for model in _refits(matches, best, rng):
        refit = _polish(matches, model)
        if refit.cost < best.cost:
            best = refit
    costs = np.concatenate([[best.cost], costs[:found]])
    return RansacReport(np.concatenate([best.model[None], models]), costs, sampled)


def _share_of_rows(matches: _Matches, motion: _Refined, rows: Ints) -> float:
    """Share of inliers among the matches of given rows; zero where a wrong motion has as many inliers by chance."""
    some = PoseProblem(matches.m[rows], matches.n[rows], matches.threshold_rad)
    inliers = int(some.explained(motion.model, matches.threshold_rad).sum())
    return inliers / len(rows) if inliers >= _LEAST_DRAWN_INLIERS else 0.0


def _refits(matches: _Matches, motion: _Refined, rng: np.random.Generator) -> Floats:
    """The best two of the models (2, 7) that are fitted to random subsets of the inliers."""
    uniform = rng.random((_REFITS, _REFIT_SIZE))
    m, n, threshold_rad = matches.m, matches.n, matches.threshold_rad
    return kernels.refit(m, n, motion.model, threshold_rad, uniform, _MOST_COMPARED, _STEPS, _RUNNERS_UP)


def _polish(matches: _Matches, model: Floats) -> _Refined:
    """Refine a model on the matches near it."""
    stages = matches.threshold_rad * _STAGES
    return _Refined(*kernels.climb(matches.m, matches.n, model, matches.threshold_rad, stages, _MOST_NEAR, _STEPS))
