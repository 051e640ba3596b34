"""The term *competing* of the risk: the probability that another motion is right.

Each track votes by the difference of its two log likelihoods, by three nats at the most: so much it costs to say that
the track is an outlier. The image region with the largest vote is left out, since a moving object or a step in the
scene fills a region. What the fields of correlated errors explain of the competing motion counts for it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from quest.robust.spatial_blocks import regions_of
from slam_init.types.arrays import Floats
from slam_init.types.correlated_errors import FIELD_PRIOR, FIELD_SCALES_PX
from slam_init.types.evidence import Margin
from slam_init.window.arguments import Limits
from slam_init.window.hypotheses import FAR_BEHIND, WindowHypotheses
from slam_init.window.joint_fit import fit_window
from slam_init.window.levels import OBJECTS_MOVE, UNDECIDED, WRONG_DIRECTION_DEG, WRONG_ROTATION_DEG
from slam_init.window.motion import FittedMotion
from slam_init.window.state import Priors
from slam_init.window.uncertainty import ExpandedFit, at_any_time, expand_for_evidence, places_of

#: A scale of the fields with a smaller probability changes nothing.
#: Class: level.
_UNLIKELY = 0.01
#: Largest number of Gauss-Newton steps from a fit without fields to one with fields: they converge quadratically.
_STEPS_WITH_FIELDS = 5
#: A competing motion that is further behind than this is not looked at with fields of correlated errors: they explain
#: less.
_FAR_BEHIND_NATS = 0.5 * FAR_BEHIND


def competing_term(
    hypotheses: WindowHypotheses, spread_deg: float, *, with_fits: bool = True
) -> tuple[float, Margin | None]:
    """The probability that a competing motion is right, and the vote against the nearest one.

    * ``with_fits``: Whether the motions are fitted with fields too, which only raises the probability.
    """
    best, *others = hypotheses.motions
    margins = [_margin(hypotheses, best, other) for other in others]

    probability = sum(
        _competing_probability(hypotheses, other, margin, with_fits=with_fits)
        * _wrong_if_right(best, other, spread_deg)
        for other, margin in zip(others, margins, strict=True)
    )
    return min(1.0, probability), min(margins, key=Margin.decision_ratio, default=None)


def competing_odds(hypotheses: WindowHypotheses) -> list[float]:
    """The probability of each competing motion over that of the best motion, without a bound from above.

    The risk always leaves out the region with the largest vote. Here a moving object fills it with a prior probability.
    """
    best, odds = hypotheses.motions[0], []
    for other in hypotheses.motions[1:]:
        without, of_all = (
            _competing_probability(hypotheses, other, _margin(hypotheses, best, other, of_all=of_all))
            for of_all in (False, True)
        )
        probability = OBJECTS_MOVE * without + (1 - OBJECTS_MOVE) * of_all
        odds.append(probability / (1 - probability))
    return odds


def _margin(hypotheses: WindowHypotheses, best: FittedMotion, other: FittedMotion, *, of_all: bool = False) -> Margin:
    """The vote of the tracks. A competing motion that locates fewer views explains the other views as outliers."""
    votes = hypotheses.votes(best, other)
    where = places_of(best.fit)
    largest = 0.0 if of_all else float(np.bincount(regions_of(where), weights=votes).max())
    ahead = 0.5 * (float(votes.sum()) - max(largest, 0.0))
    # Two equivalent motions have the same likelihood, but each fit adapts to the noise by unknowns of its own. With the
    # projections P1, P2 on these, the difference is e^T (P1 - P2) e / 2: its variance is half the sum of squared votes.
    # Such votes are symmetric about zero, so those against the best motion give their sum; real votes are left out.
    against = 0.5 * np.minimum(votes, 0.0)
    return Margin(ahead, ahead / max(float(np.linalg.norm(against)), 1e-9))


def _competing_probability(
    hypotheses: WindowHypotheses, other: FittedMotion, margin: Margin, *, with_fits: bool = True
) -> float:
    """Probability that the competing motion is right: the odds of the votes, less what correlated errors explain."""
    behind = margin.log_likelihood
    if behind <= 0.0 or behind > _FAR_BEHIND_NATS:
        return 0.5 if behind <= 0.0 else 0.0
    seen, best = hypotheses.tracks.seen, hypotheses.motions[0]
    missing = int(seen[list(best.rows)].sum()) - int(seen[list(other.rows)].sum())
    outliers = hypotheses.priors.gate_sigmas**2 * missing
    ahead = max(0.5 * (other.fit.cost + outliers - best.fit.cost), 1e-9)
    of_best, of_other = hypotheses.expanded, expand_for_evidence(other)
    # The fields explain a share of the difference of the costs, and the same share of the votes. A wrong motion absorbs
    # a part of the fields, so that it seems to need smaller ones. The fields belong to the tracker and not to the
    # motion: the motions are compared at each scale that is likely with both.
    both = np.sqrt(of_best.scale_weights * of_other.scale_weights)
    explained = of_other.marginal.fields.log_evidence - of_best.marginal.fields.log_evidence
    probability = float(both @ _odds(margin, 1 - explained / ahead))
    if probability > UNDECIDED or not with_fits:
        return probability
    # Fields may move a fit so far that its expansion does not hold: the fits are repeated with the likeliest fields.
    scales = [(np.argmax(of_best.scale_weights), np.argmax(of_other.scale_weights), 1.0)]
    if both.max() > _UNLIKELY:
        scales.append((np.argmax(both), np.argmax(both), float(both.max())))
    for scale_of_best, scale_of_other, weight in scales:
        cost = _cost_with_fields(best, hypotheses.priors, of_best, float(FIELD_SCALES_PX[scale_of_best]))
        other_cost = _cost_with_fields(other, hypotheses.priors, of_other, float(FIELD_SCALES_PX[scale_of_other]))
        left = 0.5 * (other_cost + outliers - cost) / ahead
        probability = max(probability, weight * float(_odds(margin, np.array([left]))[0]))
    return probability


def _odds(margin: Margin, left: Floats) -> Floats:
    """Probability of a competing motion of which these shares of the margin are left: by its odds, or at even odds."""
    left = np.clip(left, 0.0, 1.0)
    equal = np.array([at_any_time(float(margin.z * share)) for share in left])
    return np.asarray(np.maximum(1 / (1 + np.exp(margin.log_likelihood * left)), equal))


def _cost_with_fields(motion: FittedMotion, priors: Priors, expanded: ExpandedFit, scale_px: float) -> float:
    """The cost of a motion that is fitted with fields of a scale, with the cost of that many unknowns and the scale."""
    unknowns = float(np.log1p(scale_px**2 * expanded.marginal.fields.strength).sum())
    unknowns -= 2 * math.log(float(FIELD_PRIOR[scale_px == FIELD_SCALES_PX][0]))
    if not scale_px:
        return unknowns + motion.fit.cost
    with_fields = replace(priors, field_sigma_px=scale_px)
    limits = Limits(max_steps=_STEPS_WITH_FIELDS)
    return unknowns + fit_window(motion.fit.tracks, motion.fit.state, with_fields, limits=limits).cost


def _wrong_if_right(best: FittedMotion, other: FittedMotion, sigma_deg: float) -> float:
    """Probability that the map of the best motion is wrong if the competing one is right; 0 where both agree."""
    rotation_deg, direction_deg = best.difference_deg(other)
    if rotation_deg > WRONG_ROTATION_DEG:
        return 1.0
    left_deg = max(WRONG_DIRECTION_DEG - direction_deg, 0.0)
    return math.exp(-0.5 * (left_deg / max(sigma_deg, 1e-9)) ** 2)
