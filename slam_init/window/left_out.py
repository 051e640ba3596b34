"""Whether the best motion stands on one half of the view: the rest prefers another motion, far from it.

A body that fills a large part of the view can pull the fit to a motion that explains body and scene together, with few
tracks left that would tell a motion of their own. Then the scene alone prefers another motion. Which tracks are the
scene is not known, but a body is compact. So compact halves of the tracks are left out in turn, and the motion is
fitted to the other half.
"""

from __future__ import annotations

import math

import numpy as np

from quest.tails import gaussian_tail
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import (
    BODIES_MOVE,
    EVEN_ODDS,
    FAR_IN_A_HALF,
    HELD_BY_A_BODY,
    LARGEST_TENSION,
    LEAST_TRACKS,
    ON_BODIES,
    UNDECIDED,
)
from slam_init.window.motion import errors_if, fit_motion
from slam_init.window.neighbours import HALVES, far_halves, variance_by_neighbours
from slam_init.window.tails import chi_square_as_gaussian
from slam_init.window.uncertainty import places_of

#: Steps of a fit: it starts at the best motion.
_STEPS = 15


def wrong_by_a_half(hypotheses: WindowHypotheses) -> float:
    """Probability that a body on one half of the view holds the best motion, and that it is wrong.

    It may be wrong where the other half has a motion that is far from it. A body shows where the cost of that half
    falls by more than by chance: of all its tracks if the pair moves, else of those that the best motion explains. By
    chance it falls as chi-square does, with the degrees of freedom of the share that was left out.
    """
    best, priors = hypotheses.motions[0], hypotheses.priors
    # The scene around a body may be what the best motion explains in part. Wrong matches are farther from it.
    used = np.flatnonzero(best.fit.explains | best.fit.near_misses)
    if len(used) < LEAST_TRACKS:
        return 0.0
    places = places_of(best.fit)
    scale = best.fit.dispersion * variance_by_neighbours(best.fit, places)
    freedom = ON_BODIES * (6 * (len(best.rows) - 1) - 1)
    wrong = 0.0
    for half in far_halves(places[used]):
        rest = used[half]
        costs, explained = best.fit.track_costs[rest], best.fit.explains[rest]
        # A gain below the mean of what chance gains shows no body.
        hopeless = float(costs.sum()) - scale * freedom
        fitted = fit_motion(best.tracks.of_tracks(rest), best.motion, priors, hopeless, max_steps=_STEPS)
        of_pair, largest = errors_if(best.motion, fitted.motion)
        gains = costs - fitted.fit.track_costs
        # Tracks that drift, or follow a mirror image, let single views of any half move: they tell of the pair alone.
        by_pair, by_views = float(gains.sum()), float(gains[explained].sum())
        gain = max(by_pair * (of_pair > FAR_IN_A_HALF), by_views * (largest > FAR_IN_A_HALF), 0.0) / scale
        wrong = max(wrong, _probability(float(chi_square_as_gaussian(np.array([gain / freedom]), freedom)[0])))
        if wrong > UNDECIDED:
            break
    return wrong


def _probability(largest: float) -> float:
    """Probability of a body that holds the best motion, by the largest gain of a half, in standard deviations."""
    below, count = 1 - gaussian_tail(largest), HALVES
    if below**count < EVEN_ODDS:
        return 0.0
    by_chance = count * math.exp(-0.5 * largest**2) / math.sqrt(2 * math.pi) * below ** (count - 1)
    by_body = BODIES_MOVE * HELD_BY_A_BODY / LARGEST_TENSION
    return float(by_body / (by_body + by_chance))
