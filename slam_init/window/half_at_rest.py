"""Whether a camera that only rotates explains the half of the tracks that is at rest, and bodies hold the others.

Before a camera that only rotates, a moving body looks like a near object before points at infinity. Which tracks lie on
a body is not known: the half that such a camera explains best is searched for by least trimmed squares (Rousseeuw and
Van Driessen, "Computing LTS regression for large data sets", 2006). The camera is fitted to a half of the tracks, and
the half that it explains best takes their place, in turn. Bodies may hold the fit to all tracks. They are compact, so
that a second start is one of the compact halves of the view.
"""

from __future__ import annotations

import math

import numpy as np

from slam_init.types.arrays import Floats, Ints
from slam_init.window.hypotheses import CERTAIN_SIGMAS, WindowHypotheses
from slam_init.window.joint_fit import JointFit
from slam_init.window.lens_offset import LensOffset
from slam_init.window.levels import CHANCE_GAIN
from slam_init.window.neighbours import far_halves
from slam_init.window.other_motion import explained_tracks
from slam_init.window.rotation_by_tracks import costs_of_rotation, rotation_of
from slam_init.window.tails import at_any_look
from slam_init.window.uncertainty import places_of

#: Rounds of a fit and a choice of the half; it ends where the half stays. Steps of a fit that only starts them.
_ROUNDS, _START_STEPS = 3, 4


def bodies_probability(hypotheses: WindowHypotheses, share: float, *, anew: bool = False, price: float = 0.0) -> float:
    """Probability of the gains over the rotation-only camera if this share of the tracks, which gain most, moves.

    * ``price``: A part of the gain that no track is needed for, in twice the nats.
    * ``anew``: Whether the rest is searched for, and not taken from the fit of that camera to all tracks, which bodies
      pull.
    """
    best = hypotheses.motions[0]
    explained = np.flatnonzero(explained_tracks(hypotheses))
    costs = hypotheses.costs_of(best)[explained]
    gains = hypotheses.rotation_only.track_costs[explained] - costs
    count = len(explained) - int(share * len(explained))
    if not count:
        return 1.0
    by_chance, sigma = CHANCE_GAIN * count, math.sqrt(2 * count)
    least = float(np.partition(gains, count - 1)[:count].sum())
    if anew:
        # How far a gain is beyond what is certain does not matter.
        certain = best.fit.dispersion * (by_chance + CERTAIN_SIGMAS * sigma)
        lens, chosen = hypotheses.rotation_only.state.lens, _smallest(gains, count)
        least = min(least, _least_gain(hypotheses, explained, costs, chosen, lens, certain))
        chosen, lens = _compact_start(hypotheses, explained, costs, count)
        least = min(least, _least_gain(hypotheses, explained, costs, chosen, lens, certain))
    return at_any_look(((price + least) / best.fit.dispersion - by_chance) / sigma)


def _compact_start(hypotheses: WindowHypotheses, explained: Ints, costs: Floats, count: int) -> tuple[Ints, LensOffset]:
    """The half that a camera explains best which only rotates as one of the compact halves says, and its lens."""
    lens = LensOffset(readout_s=hypotheses.rotation_only.state.lens.readout_s)
    gains = list[tuple[float, JointFit]]()
    for half in far_halves(places_of(hypotheses.motions[0].fit)[explained]):
        hopeless = float(costs[half].sum()) + min((gain for gain, _ in gains), default=math.inf)
        fit = rotation_of(hypotheses, explained[half], lens, max_steps=_START_STEPS, hopeless=hopeless)
        gains.append((float((fit.track_costs - costs[half]).sum()), fit))
    lowest = min(gains, key=lambda one: one[0])[1]
    return _smallest(costs_of_rotation(hypotheses, explained, lowest) - costs, count), lowest.state.lens


def _smallest(gains: Floats, count: int) -> Ints:
    return np.sort(np.argsort(gains, kind="stable")[:count])


def _least_gain(
    hypotheses: WindowHypotheses, explained: Ints, costs: Floats, chosen: Ints, lens: LensOffset, certain: float
) -> float:
    """The gain over a camera that only rotates of the half that it explains best, from some half on.

    * ``certain``: A fit that cannot bring the gain down to this is given up.
    """
    least = math.inf
    for _ in range(_ROUNDS):
        fit = rotation_of(hypotheses, explained[chosen], lens, hopeless=float(costs[chosen].sum()) + certain)
        least = min(least, float((fit.track_costs - costs[chosen]).sum()))
        again = _smallest(costs_of_rotation(hypotheses, explained, fit) - costs, len(chosen))
        if np.array_equal(again, chosen):
            break
        chosen, lens = again, fit.state.lens
    return least
