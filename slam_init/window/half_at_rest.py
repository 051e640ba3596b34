"""Whether a camera that only rotates explains the tracks that are at rest, and bodies hold the others.

Before a camera that only rotates, a moving body looks like a near object before points at infinity. Which tracks lie on
a body is not known. Those at rest are searched for by least trimmed squares (Rousseeuw and Van Driessen, "Computing LTS
regression for large data sets", 2006): such a camera is fitted to some of the tracks, and as many that it explains best
take their place, in turn. Bodies may hold the fit to all tracks. They are compact, so that a second start is the rest
of the view around one of nine places.

A body may hold up to half of the tracks at no price. Larger ones are rare, and the odds of
:mod:`~slam_init.window.other_motion` say how rare. And they hide what is behind them, whereas near and far objects of a
scene at rest may lie among each other.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.hypotheses import CERTAIN_SIGMAS, WindowHypotheses
from slam_init.window.joint_fit import JointFit
from slam_init.window.levels import CHANCE_GAIN, FLOOR, LARGE_BODIES, ON_BODIES
from slam_init.window.neighbours import far_from_places, separation_in_view
from slam_init.window.other_motion import explained_tracks, odds_of_body
from slam_init.window.rotation_by_tracks import costs_of_rotation, rotation_of
from slam_init.window.state import WindowState
from slam_init.window.tails import at_any_look
from slam_init.window.uncertainty import places_of

#: Rounds of a fit and a choice of the half; it ends where the half stays. Steps of a fit that only starts them.
_ROUNDS, _START_STEPS = 3, 4


def beside_bodies(hypotheses: WindowHypotheses, *, anew: bool = False) -> float:
    """Probability that the camera only rotates, and that the tracks that gain most by a translation lie on bodies.

    The largest bodies come first: where the other tracks show a translation, more of them show it too.

    * ``anew``: Whether the tracks at rest are searched for, and not taken from the fit of that camera to all tracks,
      which bodies pull.
    """
    found = 0.0
    for share in (*LARGE_BODIES, ON_BODIES):
        probability, at_rest = _probability(hypotheses, share, anew=anew)
        rarity = _of_large_body(hypotheses, at_rest) if share > ON_BODIES else 1.0
        found = max(found, probability * rarity)
        if probability <= FLOOR:
            break
    return found


def _of_large_body(hypotheses: WindowHypotheses, at_rest: Bools) -> float:
    """Probability that a body holds all explained tracks but some (T,).

    Bodies are opaque: where tracks at rest lie among the others, these are near objects, and no body.
    """
    explained = explained_tracks(hypotheses)
    odds = odds_of_body(hypotheses, explained & ~at_rest, at_rest)
    places = places_of(hypotheses.motions[0].fit)[explained]
    return odds / (1 + odds) * separation_in_view(places, at_rest[explained])


def bodies_probability(hypotheses: WindowHypotheses, share: float, *, price: float = 0.0) -> float:
    """Probability of the gains over the rotation-only camera if this share of the tracks, which gain most, moves.

    * ``price``: A part of the gain that no track is needed for, in twice the nats.
    """
    return _probability(hypotheses, share, price=price)[0]


def _probability(
    hypotheses: WindowHypotheses, share: float, *, anew: bool = False, price: float = 0.0
) -> tuple[float, Bools]:
    """The same, and the tracks (T,) at rest; see :func:`beside_bodies` for ``anew``."""
    best = hypotheses.motions[0]
    explained = np.flatnonzero(explained_tracks(hypotheses))
    costs = hypotheses.costs_of(best)[explained]
    gains = hypotheses.rotation_only.track_costs[explained] - costs
    count, at_rest = len(explained) - int(share * len(explained)), np.zeros(len(hypotheses.tracks.anchor), bool)
    if not count:
        return 1.0, at_rest
    by_chance, sigma = CHANCE_GAIN * count, math.sqrt(2 * count)
    chosen = _smallest(gains, count)
    least = float(gains[chosen].sum())
    if anew:
        # How far a gain is beyond what is certain does not matter.
        certain = best.fit.dispersion * (by_chance + CERTAIN_SIGMAS * sigma)
        starts = ((chosen, hypotheses.rotation_only.state), _compact_start(hypotheses, explained, costs, count, share))
        for start, lens in starts:
            gain, rest = _least_gain(hypotheses, explained, costs, start, lens, certain)
            if gain < least:
                least, chosen = gain, rest
    at_rest[explained[chosen]] = True
    return at_any_look(((price + least) / best.fit.dispersion - by_chance) / sigma), at_rest


def _compact_start(
    hypotheses: WindowHypotheses, explained: Ints, costs: Floats, count: int, share: float
) -> tuple[Ints, WindowState]:
    """The tracks that a camera explains best which only rotates as the rest around a place says, and its lens."""
    lens = replace(hypotheses.rotation_only.state, log_scale=0.0, k1=0.0, principal_px=np.zeros(2))
    gains = list[tuple[float, JointFit]]()
    for rest in far_from_places(places_of(hypotheses.motions[0].fit)[explained], share):
        hopeless = float(costs[rest].sum()) + min((gain for gain, _ in gains), default=math.inf)
        fit = rotation_of(hypotheses, explained[rest], lens, max_steps=_START_STEPS, hopeless=hopeless)
        gains.append((float((fit.track_costs - costs[rest]).sum()), fit))
    lowest = min(gains, key=lambda one: one[0])[1]
    return _smallest(costs_of_rotation(hypotheses, explained, lowest) - costs, count), lowest.state


def _smallest(gains: Floats, count: int) -> Ints:
    return np.sort(np.argsort(gains, kind="stable")[:count])


def _least_gain(
    hypotheses: WindowHypotheses, explained: Ints, costs: Floats, chosen: Ints, lens: WindowState, certain: float
) -> tuple[float, Ints]:
    """The gain over a camera that only rotates of the tracks that it explains best, from some tracks on; and these.

    * ``certain``: A fit that cannot bring the gain down to this is given up.
    """
    least, of_least = math.inf, chosen
    for _ in range(_ROUNDS):
        fit = rotation_of(hypotheses, explained[chosen], lens, hopeless=float(costs[chosen].sum()) + certain)
        gain = float((fit.track_costs - costs[chosen]).sum())
        if gain < least:
            least, of_least = gain, chosen
        again = _smallest(costs_of_rotation(hypotheses, explained, fit) - costs, len(chosen))
        if np.array_equal(again, chosen):
            break
        chosen, lens = again, fit.state
    return least, of_least
