"""The search for the motion that explains most matches: locally optimized RANSAC over samples of five.

Samples are drawn in chunks by numpy, solved and scored by the compiled loops of :mod:`quest.robust.kernels`, and the best of
each chunk is refined on its inliers. :func:`quest.robust.ransac.ransac` with :class:`quest.robust.pose_problem.RelativePoseProblem`
is the readable counterpart: the same search over samples of six or seven, with QuEst's eigenproblems, in plain numpy.

References
----------
.. [1] O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC", DAGM 2003.
.. [2] P. H. S. Torr, A. Zisserman, "MLESAC", CVIU 2000 (the truncated cost, there MSAC).
.. [3] O. Chum, J. Matas, "Matching with PROSAC: progressive sample consensus", CVPR 2005.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import quaternion_from_matrix
from quest.robust.ransac import RansacReport, draw_samples, samples_needed

__all__ = ["progressive_samples", "search_five"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SAMPLE_SIZE = 5
#: The chunks grow: easy data stop after the first, hard data need few calls.
_FIRST_CHUNK, _LARGEST_CHUNK = 64, 1024
#: From noisy samples without outliers, the share that two starts lead next to the motion: 0.2 to 0.5 over general and
#: planar scenes, baselines from .03 to .5 of the depth and 0.7 px at a focal length of 458 px. Refinement widens it.
_YIELD = 0.35
#: Modes that the pool holds: at most three alternatives are reported, and several modes may be refined into one. And
#: how many of the best, and of the refits, are refined in the end: each costs a tenth of a millisecond or two.
_POOL, _RUNNERS_UP = 8, 2
#: Subsets of the inliers that the result is refitted to in the end, and their size: enough for five unknowns to be
#: better known than from five matches, few enough to leave out what holds the result in a local optimum.
_REFITS, _REFIT_SIZE = 20, 14
#: Inliers among the best-scored matches that are no chance: five are the sample's own, and as many again.
_LEAST_DRAWN_INLIERS = 10
#: PROSAC draws from all data after this many samples at the latest, as its authors propose.
_PROSAC_SAMPLES = 200_000


def search_five(
    m: Floats,
    n: Floats,
    threshold_rad: float,
    rng: np.random.Generator,
    rotation: Floats,
    *,
    confidence: float,
    max_samples: int,
    scores: Floats | None = None,
) -> RansacReport | None:
    """Search for the motion of least truncated cost.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings, N >= 5.
    threshold_rad : float
        Sampson error from which on a match is an outlier.
    rng : numpy.random.Generator
    rotation : (3, 3) float
        The rotation that explains most matches by itself: one of the two that samples are solved from. The other is
        the identity, since a rotation fitted to matches takes up part of a translation.
    confidence : float
        With which the best motion is found.
    max_samples : int
    scores : (N,) float, optional
        Quality of the matches, higher is better: the better ones are drawn earlier.

    Returns
    -------
    RansacReport or None
        Its models are rows (q_wxyz, t): the refined best one, then the best of each other mode. None where no sample
        has a solution.
    """
    from quest.robust import kernels

    count = len(m)
    # Matches come sorted as often as not (by image row, by quality); the bail-out wants any of them first.
    order = rng.permutation(count)
    m_any, n_any = np.ascontiguousarray(m[order]), np.ascontiguousarray(n[order])
    by_score = None if scores is None else np.argsort(-scores[order], kind="stable")
    rotations = np.stack([np.eye(3), rotation])
    pool_R, pool_t = np.zeros((_POOL, 3, 3)), np.zeros((_POOL, 3))
    pool_costs, pool_inliers = np.full(_POOL, np.inf), np.zeros(_POOL, np.int64)
    chance = np.zeros(2)
    best: tuple[Floats, Floats] | None = None
    best_cost, best_inliers, polished_cost = math.inf, 0, math.inf
    drawn, chunk = 0, _FIRST_CHUNK
    while drawn < max_samples:
        chunk = min(chunk, max_samples - drawn)
        if by_score is None:
            samples = draw_samples(rng, count, _SAMPLE_SIZE, chunk)
        else:
            samples = by_score[progressive_samples(rng, count, _SAMPLE_SIZE, drawn, chunk)]
        directions = rng.normal(size=(chunk, len(rotations), 3))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        kernels.try_samples(
            m_any,
            n_any,
            samples,
            rotations,
            directions,
            threshold_rad,
            pool_R,
            pool_t,
            pool_costs,
            pool_inliers,
            chance,
        )
        drawn += chunk
        # A raw model from five noisy matches is worse than the same one refined, so each new leader is refined.
        if pool_costs[0] < polished_cost:
            polished_cost = pool_costs[0]
            R, t, cost, inliers = _polish(m_any, n_any, pool_R[0], pool_t[0], threshold_rad)
            if cost < best_cost:
                best, best_cost, best_inliers = (R, t), cost, inliers
        share = best_inliers / count
        if by_score is not None and best is not None:
            # The samples so far came from the best-scored matches, and among those there are more inliers.
            share = max(
                share, _share_of_drawn(m_any, n_any, *best, threshold_rad, by_score[: _samples_reach(count, drawn)])
            )
        needed = samples_needed(share, _SAMPLE_SIZE, confidence, _YIELD)
        if drawn >= needed:
            break
        chunk = min(2 * chunk, _LARGEST_CHUNK, max(_FIRST_CHUNK, math.ceil(min(needed, max_samples)) - drawn))
    if best is None:
        return None
    # The noise of five matches may have led next to the best optimum, and refinement into the near one.
    found = np.isfinite(pool_costs)
    # One that as a raw model misses half of the inliers is not next to it.
    near = found & (pool_costs < pool_costs[0] + 0.5 * best_inliers * threshold_rad**2)
    others = list(zip(pool_R[near], pool_t[near], strict=True))[1 : 1 + _RUNNERS_UP]
    for R, t in [*others, *_refits(m_any, n_any, *best, threshold_rad, rng)]:
        R, t, cost, _ = _polish(m_any, n_any, R, t, threshold_rad)
        if cost < best_cost:
            best, best_cost = (R, t), cost
    rest = np.concatenate([quaternion_from_matrix(pool_R[found]), pool_t[found]], axis=1)
    first = np.concatenate([quaternion_from_matrix(best[0]), best[1]])
    return RansacReport(np.vstack([first, rest]), np.concatenate([[best_cost], pool_costs[found]]), drawn)


def progressive_samples(rng: np.random.Generator, count: int, size: int, drawn: int, batch: int) -> Ints:
    """The samples number ``drawn`` to ``drawn + batch`` of PROSAC: ranks (batch, size), 0 is the best match [3]_.

    The k-th sample holds the match at the end of a growing set of the best, and others of that set.
    """
    ends = _growth(count, size)
    newest = np.searchsorted(ends, np.arange(drawn, drawn + batch), side="right") + size - 1
    samples = np.empty((batch, size), np.int64)
    uniform = newest >= count
    samples[uniform] = draw_samples(rng, count, size, int(uniform.sum()))
    last = newest[~uniform]
    progressive = np.empty((len(last), size), np.int64)
    progressive[:, 0] = last
    # Floyd's way to draw a subset of what lies before: a number that was drawn already gives way to the range's end.
    for k in range(1, size):
        end = last - size + k
        number = rng.integers(end + 1)
        known = (progressive[:, 1:k] == number[:, None]).any(axis=1)
        progressive[:, k] = np.where(known, end, number)
    samples[~uniform] = progressive
    return samples


def _samples_reach(count: int, drawn: int, size: int = _SAMPLE_SIZE) -> int:
    """From how many of the best matches the first ``drawn`` samples of PROSAC come."""
    return min(int(np.searchsorted(_growth(count, size), drawn - 1, side="right")) + size, count)


def _growth(count: int, size: int) -> Floats:
    """Numbers of samples after which PROSAC draws from size + 1, size + 2, ... count matches: T_g, eq. 3 of [3]_."""
    grown = np.arange(size, count + 1)
    log_share = np.zeros(len(grown))
    for k in range(size):
        log_share += np.log((grown - k) / (count - k))
    steps = np.maximum(np.ceil(np.diff(_PROSAC_SAMPLES * np.exp(log_share), prepend=0.0)), 1.0)
    return np.asarray(np.cumsum(steps))


def _share_of_drawn(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, rows: Ints) -> float:
    """The share of inliers among some matches; none where they are so few that a wrong motion fits them by chance."""
    from quest.robust import kernels

    r2, behind = kernels.residuals(m[rows], n[rows], R, t, threshold_rad)
    inliers = int(((r2 < threshold_rad**2) & ~behind).sum())
    return inliers / len(rows) if inliers >= _LEAST_DRAWN_INLIERS else 0.0


def _refits(
    m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, rng: np.random.Generator
) -> list[tuple[Floats, Floats]]:
    """The few best of the models that subsets of the inliers lead to."""
    from quest.robust import kernels

    r2, behind = kernels.residuals(m, n, R, t, threshold_rad)
    inliers = np.flatnonzero((r2 < threshold_rad**2) & ~behind)
    if len(inliers) <= _REFIT_SIZE:
        return []
    refits = []
    for subset in inliers[draw_samples(rng, len(inliers), _REFIT_SIZE, _REFITS)]:
        R_i, t_i = R.copy(), t.copy()
        every = np.ones(_REFIT_SIZE, bool)
        kernels.refine(m[subset], n[subset], every, R_i, t_i, 2 * threshold_rad, 6)
        cost, _ = kernels.score(m, n, R_i, t_i, threshold_rad, np.inf)
        refits.append((cost, R_i, t_i))
    refits.sort(key=lambda refit: refit[0])
    return [(R_i, t_i) for _, R_i, t_i in refits[:_RUNNERS_UP]]


def _polish(m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float) -> tuple[Floats, Floats, float, int]:
    """A model refined on the matches near it, its cost and number of inliers."""
    from quest.robust import kernels

    R, t = R.copy(), t.copy()
    # Twice the gate at first: a model from five noisy matches misses many of its own inliers by a little.
    for gate_rad, scale_rad in ((2 * threshold_rad, threshold_rad), (threshold_rad, 0.5 * threshold_rad)):
        r2, behind = kernels.residuals(m, n, R, t, threshold_rad)
        near = (r2 < gate_rad**2) & ~behind
        if near.sum() < _SAMPLE_SIZE + 1:
            break
        kernels.refine(m, n, near, R, t, scale_rad, 6)
    cost, inliers = kernels.score(m, n, R, t, threshold_rad, np.inf)
    return R, t, cost, inliers
