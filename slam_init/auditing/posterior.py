"""The probability that the poses of a map are wrong, by the posterior over the motions of a window.

A map from anywhere is right or wrong, whichever motion the window likes best. With the motions ``k`` of the window

    P(wrong) = P(rotation) + (1 - P(rotation)) sum_k P(k) P(map is wrong | k) + P(moving) + floor

* **P(k)** by the votes of the tracks (:func:`.competing.competing_odds`).
* **P(map is wrong | k)**: the truth is Gaussian about the fit of the motion. Its direction has the shape of the
  covariance and the largest deviation that the risk of this motion states. The map is a distance away from the fit, so
  it is wrong where the truth lies outside of the disc of 15 degrees about the map, or of the ball of 5 degrees.
* **P(rotation)**: the camera only rotates. The test gives a tail probability p, which is no posterior. The Bayes factor
  for the rotation is at least ``-e p ln p`` (Sellke, Bayarri and Berger 2001), and 1 where p is no evidence.

A risk that accepts a map bounds these probabilities from above, which is safe for a system that can wait. Here a bound
from above calls right maps wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose
from slam_init.window.competing import competing_odds
from slam_init.window.hypotheses import WindowHypotheses, fit_hypotheses
from slam_init.window.levels import EVEN_ODDS, FLOOR, SHORTEST_BASELINE, WRONG_DIRECTION_DEG, WRONG_ROTATION_DEG
from slam_init.window.motion import FittedMotion
from slam_init.window.risk import WindowRisk, risk_of, with_zooming_rotation
from slam_init.window.tracks import with_lasting_errors
from slam_init.window.uncertainty import direction_uncertainty, three_directions

#: Probability that the camera of a map only rotates, before any track is seen. Of .5, .2 and .1 the last one stated
#: best how many maps were false: 66 of 287 maps with competing motions, where 63 were (docs/measurements/accuracy.md).
#: Class: measured.
_ROTATES = 0.1
#: A smaller tail of the test for a rotation adds nothing: its posterior is below 1e-4.
#: Class: level.
_CERTAIN_MOTION = 1e-5
#: Beyond so many standard deviations from the limit a tail is 0 or 1, and its series does not converge.
#: Class: level, in standard deviations.
_CERTAIN_SIGMAS = 8.0
#: Places of the integral over a Gaussian, in its standard deviations: 100 to one of them, up to a tail of 1e-12.
#: Class: budget, in standard deviations.
_PLACES = np.linspace(-7.0, 7.0, 1401)


@dataclass(frozen=True)
class MapPosterior:
    """The probability that a map is wrong, with its terms."""

    #: The best motion is right, and a map at its fit would be wrong.
    direction: float
    #: A competing motion is right, and the map is not near it.
    competing: float
    #: The camera only rotates.
    rotation: float
    #: The tracks that the best motion does not explain are the scene at rest.
    moving: float
    #: What is not modelled.
    floor: float
    #: The best motion is right, and the map is wrong because it is away from its fit.
    map: float
    #: Whether the tracks do not distinguish a translation from a camera that only rotates.
    only_rotates: bool

    @property
    def total(self) -> float:
        """Sum of the terms, at most 1."""
        return min(1.0, self.direction + self.competing + self.rotation + self.moving + self.floor + self.map)


def posterior_of(hypotheses: WindowHypotheses, risk: WindowRisk, world_from_cam: Mapping[int, Pose]) -> MapPosterior:
    """The probability that a map is wrong.

    * ``risk``: Of the best hypothesis.
    * ``world_from_cam``: The poses of the map by frame; the pair is among them.
    """
    tail = _tail_of_rotation(hypotheses, risk)
    factor = -math.e * tail * math.log(tail) if 0 < tail < 1 / math.e else float(tail > 0)
    rotation = _ROTATES * factor / (_ROTATES * factor + 1 - _ROTATES)
    odds = np.array([1.0, *competing_odds(hypotheses)])
    shares = (1 - rotation) * odds / odds.sum()
    at_fit, at_map = _wrong(hypotheses, risk, world_from_cam)
    others = [_wrong_if_competing(hypotheses, k, world_from_cam) for k in range(1, len(hypotheses.motions))]
    return MapPosterior(
        direction=float(shares[0] * at_fit),
        competing=float(shares[1:] @ np.array(others)),
        rotation=rotation,
        moving=risk.moving,
        floor=FLOOR,
        map=float(shares[0] * (at_map - at_fit)),
        only_rotates=tail > EVEN_ODDS,
    )


def is_near(world_from_cam: Mapping[int, Pose], fitted: FittedMotion) -> bool:
    """Whether the pair of a map would be right if this motion were."""
    rotation_deg, direction_deg = fitted.differences_deg(world_from_cam)[fitted.frames[1]]
    return rotation_deg <= WRONG_ROTATION_DEG and direction_deg <= WRONG_DIRECTION_DEG


def _wrong_if_competing(hypotheses: WindowHypotheses, k: int, world_from_cam: Mapping[int, Pose]) -> float:
    """Probability that the map is wrong if a competing motion is right."""
    competing = hypotheses.motions[k]
    rotation_deg, direction_deg = competing.differences_deg(world_from_cam)[competing.frames[1]]
    if rotation_deg > 2 * WRONG_ROTATION_DEG or direction_deg > 2 * WRONG_DIRECTION_DEG:
        return 1.0
    others = (one for one in hypotheses.motions if one is not competing)
    first = replace(hypotheses, motions=(competing, *others))
    return _wrong(first, risk_of(first), world_from_cam)[1]


def _wrong(hypotheses: WindowHypotheses, risk: WindowRisk, world_from_cam: Mapping[int, Pose]) -> tuple[float, float]:
    """Probability that a map is wrong if the best motion is right: of a map at its fit, and of the map."""
    best, rotation_sigma_deg = hypotheses.motions[0], risk.directions.rotation_sigma_deg
    lengths = np.linalg.norm(best.fit.state.t, axis=1)
    # The stated tail of the direction knows lenses that change from view to view.
    rotated = three_directions(WRONG_ROTATION_DEG, rotation_sigma_deg)
    tail = min(max(risk.direction - rotated, math.exp(-0.5 * _PLACES[-1] ** 2)), 1.0)
    stated_deg = WRONG_DIRECTION_DEG / max(math.sqrt(-2 * math.log(tail)), 1e-9)
    at_fit, at_map = 0.0, 0.0
    for frame, (rotation_deg, direction_deg) in best.differences_deg(world_from_cam).items():
        view = best.frames.index(frame)
        if view > 1 and lengths[view] < SHORTEST_BASELINE * lengths.max():
            continue
        uncertainty = direction_uncertainty(hypotheses.expanded, view)
        variances, axes = np.linalg.eigh(uncertainty.covariance)
        shape, sigma_deg = np.sqrt(np.maximum(variances / variances[-1], 0.0)), risk.directions.sigmas_deg[view - 1]
        pose = world_from_cam[frame].inverse() @ world_from_cam[best.frames[0]]
        across = axes.T @ (uncertainty.basis @ (pose.R.T @ pose.t))
        aside_deg = direction_deg * across / max(float(np.linalg.norm(across)), 1e-300)
        by_map = _outside_disc(aside_deg, sigma_deg * shape) + _outside_ball(rotation_deg, rotation_sigma_deg)
        if view == 1:
            at_fit = _outside_disc(np.zeros(2), stated_deg * shape) + rotated
            by_map = max(by_map, at_fit)
        at_map = max(at_map, by_map)
    return min(at_fit, 1.0), min(at_map, 1.0)


def _outside_disc(centre_deg: Floats, sigmas_deg: Floats) -> float:
    """Probability that a Gaussian vector about a centre lies outside of the disc of a wrong direction.

    Shapes: ``centre_deg, sigmas_deg`` (2,), along the axes of its covariance.
    """
    from scipy.special import ndtr

    (x, y), (short, long) = centre_deg, np.maximum(sigmas_deg, 1e-9)
    # Along the longer axis by a sum, along the other one by the distribution function.
    along = y + long * _PLACES
    half = np.sqrt(np.maximum(WRONG_DIRECTION_DEG**2 - along**2, 0.0))
    inside = np.where(half > 0, ndtr((half - x) / short) - ndtr((-half - x) / short), 0.0)
    weights = np.exp(-0.5 * _PLACES**2)
    return float(np.clip(1 - weights @ inside / weights.sum(), 0.0, 1.0))


def _outside_ball(distance_deg: float, sigma_deg: float) -> float:
    """Probability that a Gaussian rotation about a distance is wrong: the tail of noncentral chi-square."""
    from scipy.special import chndtr

    sigma = max(sigma_deg, 1e-9)
    if abs(distance_deg - WRONG_ROTATION_DEG) > _CERTAIN_SIGMAS * sigma:
        return float(distance_deg > WRONG_ROTATION_DEG)
    return float(1 - chndtr((WRONG_ROTATION_DEG / sigma) ** 2, 3, (distance_deg / sigma) ** 2))


def _tail_of_rotation(hypotheses: WindowHypotheses, risk: WindowRisk) -> float:
    """The tail probability of what the motion gains if the camera only rotates.

    It is the smaller one of two. The second one has the errors that a tracker keeps in the noise, and all motions
    fitted again with it. The risk has such a test where its direction is known. A map from anywhere is evaluated where
    it is not.
    """
    tail = min(risk.rotation, 1.0)
    if tail <= _CERTAIN_MOTION:
        return tail
    wide = with_lasting_errors(hypotheses.tracks, hypotheses.rotation_only.state.R)
    again = fit_hypotheses(wide, [one.motion for one in hypotheses.motions], hypotheses.priors)
    return tail if again is None else min(tail, with_zooming_rotation(again, risk_of(again)).rotation)
