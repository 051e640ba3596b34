"""The tracks of a window taken apart by two rigid motions: that of the scene at rest, and that of a body.

A body that holds many tracks pulls the joint fit to a motion that explains scene and body in part, with poses and a
lens that are both wrong. No robust cost helps, since that motion costs less than the right one, which leaves all tracks
of the body unexplained. But two motions cost far less than one. So where a window is refused, its tracks are taken
apart: quest proposes a motion of all tracks and another one of the rest, then each track follows the motion at which it
costs less, in turn. Which of the two motions is the camera's is told by the odds of
:mod:`~slam_init.window.other_motion`. The window is fitted anew to the tracks of the camera, and judged by these.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quest.noise import GATE_SIGMAS
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Bools, Floats
from slam_init.window.hypotheses import WindowHypotheses, fit_hypotheses
from slam_init.window.levels import CHANCE_GAIN, LARGEST_VOTE, LEAST_TRACKS, UNDECIDED
from slam_init.window.motion import FittedMotion, OtherMotion, fit_motion
from slam_init.window.neighbours import variance_by_neighbours
from slam_init.window.other_motion import Proposal, costs_at, odds_of_body, propose
from slam_init.window.risk import WindowRisk, risk_of
from slam_init.window.uncertainty import places_of

#: How often each track follows the motion at which it costs less.
_ROUNDS = 3
#: A fit that explains two motions in part leaves residuals that neighbouring tracks share: they multiply its variances
#: by more than this (1.6 to 12 in 20 drawn windows that a search decided). Without such errors the factor exceeds 1 by
#: a quarter at most by chance, with 300 tracks in two views.
#: Class: level.
_SHARED = 1.5
#: Windows that are not searched after a search in vain: a search takes as long as a judgement.
#: Class: budget.
_REST = 2


class BodySearch:
    """Looks for a body in windows that are refused, in one of three as long as none decides."""

    def __init__(self) -> None:
        self._rest = 0

    def judge(
        self, hypotheses: WindowHypotheses, risk: WindowRisk, max_risk: float
    ) -> tuple[WindowHypotheses, WindowRisk]:
        """The hypotheses by the tracks of the camera alone, with their risk, where they decide; else those given.

        They decide where the risk is small without the body, or where only the body keeps it large.
        """
        if risk.total <= max_risk or risk.other.probability > max_risk or risk.rotation > UNDECIDED:
            return hypotheses, risk
        if self._rest > 0 or not _shows_two_motions(hypotheses):
            self._rest = max(self._rest - 1, 0)
            return hypotheses, risk
        apart = without_body(hypotheses)
        if apart is not None:
            of_camera = risk_of(apart, max_risk)
            only_body = of_camera.other.probability > max_risk and of_camera.total < risk.total
            if only_body or of_camera.total <= max_risk:
                return apart, of_camera
        self._rest = _REST
        return hypotheses, risk


def without_body(hypotheses: WindowHypotheses) -> WindowHypotheses | None:
    """The hypotheses by the tracks of the camera alone, with the motion of the body; None where no body shows."""
    with single_threaded():
        apart = _taken_apart(hypotheses)
        if apart is None:
            return None
        camera, body, moving, odds = apart
        part = hypotheses.tracks.of_tracks(np.flatnonzero(~moving))
        again = propose(hypotheses, (hypotheses.tracks.anchor >= 0) & ~moving)
        starts = [] if again is None else [fitted.motion for fitted in again.fitted(hypotheses)]
        found = fit_hypotheses(part, [camera.motion, *starts], hypotheses.priors)
        other = OtherMotion(
            odds / (1 + odds), hypotheses.tracks.track_ids[moving], body, hypotheses.tracks.track_ids[~moving]
        )
        return None if found is None else replace(found, body=other, staying=hypotheses.staying)


def _shows_two_motions(hypotheses: WindowHypotheses) -> bool:
    """Whether neighbouring tracks share residuals of the best motion, as they do where it explains two in part."""
    best = hypotheses.motions[0]
    return variance_by_neighbours(best.fit, places_of(best.fit)) > _SHARED


class _Apart(NamedTuple):
    """Two motions of the tracks of a window."""

    camera: FittedMotion
    body: FittedMotion
    #: (T,) The tracks that only the motion of the body explains.
    moving: Bools
    #: Odds that the motions are exchanged, at most 1.
    odds: float


def _taken_apart(hypotheses: WindowHypotheses) -> _Apart | None:
    """The tracks by two motions; None where the tracks have no two, or where one explains them as well."""
    used, bound = hypotheses.tracks.anchor >= 0, hypotheses.largest_costs
    one = _cheapest(hypotheses, propose(hypotheses, used), bound)
    if one is None:
        return None
    follows = used & (costs_at(hypotheses, one.motion) <= bound)
    if follows.sum() < LEAST_TRACKS:
        return None
    one = _refitted(hypotheses, one, follows)
    costs = costs_at(hypotheses, one.motion)
    second = propose(hypotheses, used & (costs > bound))
    two = None if second is None or len(second.tracks) < LEAST_TRACKS else _cheapest(hypotheses, second, bound)
    if two is None:
        return None
    of_two = costs_at(hypotheses, two.motion)
    for _ in range(_ROUNDS):
        others = used & (of_two < costs)
        if min(others.sum(), (used & ~others).sum()) < LEAST_TRACKS:
            return None
        one, two = _refitted(hypotheses, one, used & ~others), _refitted(hypotheses, two, others)
        costs, of_two = costs_at(hypotheses, one.motion), costs_at(hypotheses, two.motion)
    votes = np.where(used, np.minimum(of_two, bound) - np.minimum(costs, bound), 0.0)
    only_one, only_two = votes > LARGEST_VOTE, votes < -LARGEST_VOTE
    few = min(only_one.sum(), only_two.sum()) < LEAST_TRACKS
    if few or not _gains_beyond_chance(hypotheses, np.minimum(costs, of_two), bound):
        return None
    odds = odds_of_body(hypotheses, only_one, only_two)
    if odds > 1:
        return _Apart(two, one, only_one, odds_of_body(hypotheses, only_two, only_one))
    return _Apart(one, two, only_two, odds)


def _gains_beyond_chance(hypotheses: WindowHypotheses, costs: Floats, bound: Floats) -> bool:
    """Whether two motions with these costs (T,) explain the tracks better than the best motion does, beyond chance.

    By chance the unknowns of the second motion gain, and each track by its choice between the two.
    """
    best, used = hypotheses.motions[0], hypotheses.tracks.anchor >= 0
    gain = (np.minimum(hypotheses.costs_of(best), bound) - np.minimum(costs, bound))[used].sum() / best.fit.dispersion
    freedom = 6 * (len(best.rows) - 1) - 1 + CHANCE_GAIN * int(used.sum())
    return bool(gain > freedom + GATE_SIGMAS * math.sqrt(2 * freedom))


def _cheapest(hypotheses: WindowHypotheses, proposal: Proposal | None, bound: Floats) -> FittedMotion | None:
    """The motion of a proposal at which its tracks cost least; None without one, or where they locate no view."""
    if proposal is None:
        return None
    found = proposal.fitted(hypotheses)
    costs = [float(np.minimum(costs_at(hypotheses, one.motion), bound)[proposal.tracks].sum()) for one in found]
    return found[int(np.argmin(costs))] if found else None


def _refitted(hypotheses: WindowHypotheses, one: FittedMotion, of: Bools) -> FittedMotion:
    return fit_motion(hypotheses.tracks.of_tracks(np.flatnonzero(of)), one.motion, hypotheses.priors)
