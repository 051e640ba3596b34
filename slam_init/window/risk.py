"""The risk that a map of the window's best hypothesis is wrong, and the terms that it is composed of.

Wrong means: a rotation off by more than 5 degrees, or a direction of the baseline off by more than 15 degrees. Four
causes add their probabilities:

* **direction**: the right hypothesis with a large error. The covariance of the joint fit (Laplace) gives the standard
  deviation of the direction. It knows noise, focal length and error fields.
* **rival**: another motion is right. Each track votes by the difference of its two log likelihoods, by three nats at
  the most: so much it costs to say that the track is an outlier. The image region with the largest vote is left out,
  since a moving body or a step in the scene fills a region.
* **rotation**: the camera only rotates, with a wrong focal length. Translation and points add unknowns, so they lower
  the cost by chance: twice the gain has a chi-square distribution then.
* **floor**: what is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from quest.robust.spatial_blocks import regions_of
from quest.uncertainty.tails import gaussian_tail
from slam_init.mapping.rivals import explained_at_most, margin_of
from slam_init.types.arrays import Floats
from slam_init.types.comparison import Margin
from slam_init.window.hypotheses import FittedMotion, WindowHypotheses
from slam_init.window.joint_fit import JointFit

__all__ = ["WindowRisk", "direction_sigmas_deg", "risk_of"]

#: A direction is wrong from here on.
_WRONG_DIRECTION_DEG = 15.0
#: Laplace is optimistic with few views. Factor on the standard deviation of the direction: 2.4 with two views, 1.4 with
#: twelve.
_FEW_VIEWS = 1.4
#: Largest vote of a track, as a difference of costs (twice the nats).
_LARGEST_VOTE = 6.0
#: A pair is judged again while frames arrive: with windows of 2 to 12 views about ten times. The looks share most of
#: their data, so that the sum over all looks is an upper bound.
_LOOKS = 10.0
#: Share of wrong maps that no term explains, a tenth of the largest risk that is accepted. It is an assumption: of 1268
#: drawn windows with a risk below 0.005 none was wrong, which bounds their share by 0.24 % (95 %).
_FLOOR = 5e-4


@dataclass(frozen=True)
class WindowRisk:
    """The probability that a map of the best hypothesis is wrong, with its terms.

    Attributes
    ----------
    total : float
        Sum of the terms, at most 1.
    direction, rival, rotation, floor : float
        Probabilities, see the module docstring.
    direction_sigma_deg : float
        Standard deviation of the direction of the pair's baseline where it is largest, as fitted.
    rotation_sigma_deg : float
        Standard deviation of the pair's rotation where it is largest, as fitted.
    margin : Margin or None
        The vote against the nearest rival; None without a rival.
    rotation_log_likelihood : float
        Log likelihood of the best motion over the rotation-only camera, in nats.
    """

    total: float
    direction: float
    rival: float
    rotation: float
    floor: float
    direction_sigma_deg: float
    rotation_sigma_deg: float
    margin: Margin | None
    rotation_log_likelihood: float


def risk_of(hypotheses: WindowHypotheses) -> WindowRisk:
    """Compose the risk of the best hypothesis.

    Parameters
    ----------
    hypotheses : WindowHypotheses

    Returns
    -------
    WindowRisk
    """
    best, *rivals = hypotheses.motions
    rotation_deg, direction_deg = direction_sigmas_deg(best.fit)
    margins = [_margin(hypotheses, best, rival) for rival in rivals]
    nearest = min(margins, key=Margin.decision_ratio, default=None)
    factor = _optimism(hypotheses, best)
    direction = math.exp(-0.5 * (_WRONG_DIRECTION_DEG / (factor * max(direction_deg, 1e-9))) ** 2)
    rival = min(1.0, _LOOKS * sum(_rival_probability(margin) for margin in margins))
    gain, rotation = _rotation_probability(hypotheses)
    total = min(1.0, direction + rival + rotation + _FLOOR)
    return WindowRisk(total, direction, rival, rotation, _FLOOR, direction_deg, rotation_deg, nearest, gain)


def _optimism(hypotheses: WindowHypotheses, best: FittedMotion) -> float:
    """Factor on the standard deviation of the direction, for what the covariance does not know."""
    few_views = 1 + _FEW_VIEWS / math.sqrt(len(best.rows) - 1)
    # A focal length that is pulled beyond its prior compensates errors that the model does not have.
    pull = abs(best.fit.state.log_scale) / hypotheses.priors.focal_sigma
    return few_views * max(pull, 1.0)


def direction_sigmas_deg(fit: JointFit) -> tuple[float, float]:
    """Largest standard deviations of rotation and direction of the pair, by the covariance of the fit.

    Parameters
    ----------
    fit : JointFit
        View 0 is the reference, view 1 the current frame.

    Returns
    -------
    rotation_deg, direction_deg : float
    """
    covariance = fit.pose_covariance(1)
    R, t = fit.state.R[1], fit.state.t[1]
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    # Centre -R^T t of the current camera: its derivatives by the rotation vector (from the left) and by t.
    J = np.hstack([R.T @ cross, R.T])
    length = max(float(np.linalg.norm(t)), 1e-300)
    along = R.T @ t / length
    across = np.eye(3) - np.outer(along, along)
    of_centre = across @ J @ covariance @ J.T @ across
    rotation = float(np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 0.0)))
    direction = float(np.sqrt(max(np.linalg.eigvalsh(of_centre)[-1], 0.0))) / length
    return math.degrees(rotation), math.degrees(direction)


def _margin(hypotheses: WindowHypotheses, best: FittedMotion, rival: FittedMotion) -> Margin:
    """The vote of the tracks; a rival that locates fewer views explains the others as outliers."""
    costs = [_costs_of_tracks(hypotheses, motion) for motion in (best, rival)]
    votes = np.clip(costs[1] - costs[0], -_LARGEST_VOTE, _LARGEST_VOTE)
    rays = best.fit.state.rays
    where = np.arctan2(rays[:, :2], rays[:, 2:])
    largest = float(np.bincount(regions_of(where), weights=votes).max())
    margin = margin_of(votes, where)
    return replace(margin, log_likelihood=margin.log_likelihood - 0.5 * max(largest, 0.0))


def _costs_of_tracks(hypotheses: WindowHypotheses, motion: FittedMotion) -> Floats:
    """Cost of each track, bounded: tracks that neither motion explains must not vote."""
    seen = hypotheses.tracks.seen
    placed = seen[list(motion.rows)].sum(axis=0)
    missing = seen.sum(axis=0) - placed
    freedom = np.maximum(2 * seen.sum(axis=0) - 3, 0)
    gate2 = hypotheses.priors.gate_sigmas**2
    return np.asarray(np.minimum(motion.fit.track_costs + gate2 * missing, explained_at_most(freedom)))


def _rival_probability(margin: Margin) -> float:
    """Probability that the rival is right after all, by the odds of the votes."""
    return math.exp(-max(margin.log_likelihood, 0.0))


def _rotation_probability(hypotheses: WindowHypotheses) -> tuple[float, float]:
    """Gain over the rotation-only camera (nats), and the probability of such a gain if the camera only rotates."""
    best = hypotheses.motions[0]
    views = len(best.rows)
    missing = int(hypotheses.tracks.seen.sum()) - int(hypotheses.tracks.seen[list(best.rows)].sum())
    gain = 0.5 * (hypotheses.rotation_only.cost - best.fit.cost - hypotheses.priors.gate_sigmas**2 * missing)
    # Inverse distances are not negative: a track at infinity gains by half of its noise only.
    depths = 3 if hypotheses.planar else 0.5 * int((hypotheses.tracks.anchor >= 0).sum())
    freedom = 3 * (views - 1) - 1 + depths
    # Wilson and Hilferty: the cube root of chi-square over its freedom is nearly Gaussian.
    spread = 2 / (9 * freedom)
    z = ((max(2 * gain, 0.0) / freedom) ** (1 / 3) - (1 - spread)) / math.sqrt(spread)
    return gain, gaussian_tail(z)
