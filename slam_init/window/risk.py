"""The risk that a map of the window's best hypothesis is wrong, and the terms that it is composed of.

Wrong means: a rotation off by more than 5 degrees, or a direction of the baseline off by more than 15 degrees. Five
causes add their probabilities:

* **direction**: the right motion with a large error of the direction, or of the rotation
  (:mod:`~slam_init.window.direction_term`).
* **competing**: another motion is right. Each track votes by the difference of its two log likelihoods, by three nats
  at the most: so much it costs to say that the track is an outlier. The image region with the largest vote is left out,
  since a moving object or a step in the scene fills a region. What the fields of correlated errors explain of the
  competing motion counts for it.
* **rotation**: the camera only rotates, with a wrong focal length, and translation and points gain by chance; or up to
  half of the tracks lie on moving objects; or its images zoom and shift (:mod:`~slam_init.window.rotation_term`). The
  last of these takes as long as all other terms, so it is stated where these are small alone.
* **moving**: the tracks that the best motion does not explain have a rigid motion of their own, and they may be the
  scene at rest (:mod:`~slam_init.window.other_motion`).
* **floor**: what is not modelled.

A window is evaluated at each frame: tails hold for any stopping time (:mod:`~slam_init.window.tails`).
``docs/explanation/risk.md`` derives all of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from slam_init.system.linear_algebra import single_threaded
from slam_init.types.evidence import Margin
from slam_init.types.lens import LensPrior
from slam_init.window.competing import competing_term
from slam_init.window.direction_term import DirectionTerm, direction_term, lens_of_best
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import EVEN_ODDS, FLOOR, ON_OBJECTS, UNDECIDED
from slam_init.window.motion import OtherMotion
from slam_init.window.other_motion import explained_tracks, other_motion
from slam_init.window.rotation_term import (
    keeps_errors,
    moving_objects_probability,
    rotation_probability,
    with_errors_in_noise,
    zooming_probability,
)
from slam_init.window.uncertainty import FocalOfTracks, focal_of_tracks, inverse_distances


@dataclass(frozen=True, eq=False)
class WindowRisk:
    """The probability that a map of the best hypothesis is wrong, by its terms (see the module docstring)."""

    #: Probabilities; that of moving objects is :attr:`moving`, and ``FLOOR`` is the last term.
    direction: float
    competing: float
    rotation: float
    #: The directions and the rotation of the best motion, as the fit alone knows them.
    directions: DirectionTerm
    #: Median of the relative standard deviations of the distances from the reference, in units of the pair's
    #: baseline, over the tracks that the best motion explains. The landmarks of a map have figures of their own.
    depth_sigma: float
    #: Expected standard deviation of the coefficients of the fields of correlated errors.
    correlated_px: float
    #: The lens by the best motion, or by the camera that only rotates where that is likely.
    lens: LensPrior
    #: The focal length by the tracks near the best motion, without the prior.
    focal: FocalOfTracks
    #: The vote against the nearest competing motion; None without one.
    margin: Margin | None
    #: Log likelihood of the best motion over the rotation-only camera, in nats.
    rotation_log_likelihood: float
    #: Whether the camera that only rotates was tested with the errors that a tracker keeps in the noise.
    lasting_in_noise: bool
    #: The motion of the tracks that the best motion does not explain; none where the camera merely rotates.
    other: OtherMotion

    @property
    def seeks_objects(self) -> bool:
        """Whether another motion was looked for: it is not where rotation or direction alone exclude a map."""
        return not _is_undecided(self.rotation, self.direction)

    @property
    def total(self) -> float:
        """The risk: the causes add their probabilities."""
        return min(1.0, self.direction + self.competing + self.rotation + self.moving + FLOOR)

    @property
    def moving(self) -> float:
        """The term of moving objects: the motion of other tracks is that of the camera."""
        return self.other.probability

    def of_map(self, rotation_deg: float, direction_deg: float) -> WindowRisk:
        """The risk of a map whose pair is that far from the fitted one."""
        added, directions = self.directions.of_map(rotation_deg, direction_deg)
        return replace(self, direction=min(1.0, self.direction + added), directions=directions)


def risk_of(hypotheses: WindowHypotheses, max_risk: float = 1.0) -> WindowRisk:
    """Compose the risk of the best hypothesis; above ``max_risk`` no new motion of moving objects is sought."""
    with single_threaded():
        return _risk_of(hypotheses, max_risk)


def _risk_of(hypotheses: WindowHypotheses, max_risk: float) -> WindowRisk:
    directions = direction_term(hypotheses)
    direction = directions.of_pair
    by_rotation = _rotation_risk(hypotheses, direction)
    rotation = by_rotation.probability
    other, is_undecided = OtherMotion(), _is_undecided(rotation, direction)
    if not is_undecided:
        # Another motion is sought where the window has a map without it; one that was found before is followed.
        seeks = direction + rotation + FLOOR <= max_risk
        other = other_motion(hypotheses, directions.rotation_sigma_deg, directions.sigma_deg, seeks=seeks)
    # Fits with fields take half of a frame that waits: before a camera that turns, .36 s without this condition.
    competing, nearest = competing_term(hypotheses, directions.sigma_deg, with_fits=not is_undecided)
    return WindowRisk(
        direction=direction,
        competing=competing,
        rotation=rotation,
        directions=directions,
        depth_sigma=_depth_sigma(hypotheses),
        correlated_px=hypotheses.expanded.marginal.expected_scale_px(hypotheses.expanded.scale_weights),
        lens=directions.lens if by_rotation.lens is None else by_rotation.lens,
        focal=focal_of_tracks(hypotheses.expanded),
        margin=nearest,
        rotation_log_likelihood=by_rotation.gain,
        lasting_in_noise=by_rotation.lasting_in_noise,
        other=other,
    )


def likely_lens(hypotheses: WindowHypotheses) -> LensPrior:
    """The lens by the best motion, or by the camera that only rotates where that is likely."""
    with single_threaded():
        _, rotation, lens = rotation_probability(hypotheses, hypotheses.expanded)
        return lens_of_best(hypotheses) if lens is None or rotation <= EVEN_ODDS else lens


def with_zooming_rotation(hypotheses: WindowHypotheses, risk: WindowRisk) -> WindowRisk:
    """The risk with the hypothesis of a rotation-only camera whose images zoom and shift from view to view."""
    with single_threaded():
        return replace(risk, rotation=min(1.0, risk.rotation + zooming_probability(hypotheses)))


def _is_undecided(rotation: float, direction: float) -> bool:
    """Whether a window has no map even without the terms of competing motions and objects, which need further fits."""
    return max(rotation, direction) > UNDECIDED


class _RotationRisk(NamedTuple):
    """The term of the camera that only rotates."""

    probability: float
    #: Log likelihood of the best motion over it, in nats.
    gain: float
    #: Its lens, where it is likely.
    lens: LensPrior | None
    #: Whether the errors that a tracker keeps were taken for noise.
    lasting_in_noise: bool


def _rotation_risk(hypotheses: WindowHypotheses, direction: float) -> _RotationRisk:
    """The term of the rotation-only camera: with a wrong focal length, lasting errors, or moving objects."""
    gain, rotation, lens = rotation_probability(hypotheses, hypotheses.expanded)
    likely = rotation > EVEN_ODDS
    # Another test takes two fits, which a direction that is unknown is not worth.
    lasting_in_noise = rotation > FLOOR and direction <= UNDECIDED and keeps_errors(hypotheses)
    if lasting_in_noise:
        wide = with_errors_in_noise(hypotheses)
        of_wide = rotation_probability(wide, wide.expanded, lasting_in_noise=True)[1]
        of_wide = max(of_wide, _beside_objects(wide))
        lasting_in_noise, rotation = of_wide < rotation, min(of_wide, rotation)
    rotation = max(rotation, _beside_objects(hypotheses))
    return _RotationRisk(rotation, gain, lens if likely else None, lasting_in_noise)


def _beside_objects(hypotheses: WindowHypotheses) -> float:
    """Probability of the camera that only rotates beside moving objects.

    Points at infinity lie on no plane, so that a plane needs no such test.
    """
    return 0.0 if hypotheses.planar else moving_objects_probability(hypotheses, ON_OBJECTS)


def _depth_sigma(hypotheses: WindowHypotheses) -> float:
    """Median relative deviation of the distances of the tracks that the best motion explains; infinite without one."""
    distances = inverse_distances(hypotheses.expanded)
    sigmas = replace(distances, known=distances.known & explained_tracks(hypotheses)).relative_sigmas
    return float(np.median(sigmas)) if len(sigmas) else math.inf
