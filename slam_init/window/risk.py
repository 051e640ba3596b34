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

Windows are evaluated at nearly each frame: tails hold for any stopping time (:func:`.uncertainty.at_any_time`).
``docs/explanation/risk.md`` derives all of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from slam_init.system.linear_algebra import single_threaded
from slam_init.types.correlated_errors import FIELD_SCALES_PX
from slam_init.types.evidence import Margin
from slam_init.types.lens import LensPrior
from slam_init.window.competing import competing_term
from slam_init.window.direction_term import DirectionTerm, direction_term, lens_of_best
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import FLOOR, UNDECIDED
from slam_init.window.motion import OtherMotion
from slam_init.window.other_motion import other_motion
from slam_init.window.rotation_term import rotation_probability, rotation_term, zooming_probability
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
        directions = direction_term(hypotheses)
        direction, expanded = directions.of_pair, hypotheses.expanded
        by_rotation = rotation_term(hypotheses, direction)
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
            correlated_px=float(expanded.scale_weights @ FIELD_SCALES_PX),
            lens=directions.lens if by_rotation.lens is None else by_rotation.lens,
            focal=focal_of_tracks(expanded),
            margin=nearest,
            rotation_log_likelihood=by_rotation.gain,
            lasting_in_noise=by_rotation.lasting_in_noise,
            other=other,
        )


def likely_lens(hypotheses: WindowHypotheses) -> LensPrior:
    """The lens by the best motion, or by the camera that only rotates where that is likely."""
    with single_threaded():
        lens = rotation_probability(hypotheses, hypotheses.expanded).lens
        return lens_of_best(hypotheses) if lens is None else lens


def with_zooming_rotation(hypotheses: WindowHypotheses, risk: WindowRisk) -> WindowRisk:
    """The risk with the hypothesis of a rotation-only camera whose images zoom and shift from view to view."""
    with single_threaded():
        return replace(risk, rotation=min(1.0, risk.rotation + zooming_probability(hypotheses)))


def _is_undecided(rotation: float, direction: float) -> bool:
    """Whether a window has no map even without the terms of competing motions and objects, which need further fits."""
    return max(rotation, direction) > UNDECIDED


def _depth_sigma(hypotheses: WindowHypotheses) -> float:
    """Median relative deviation of the distances of the tracks that the best motion explains; infinite without one."""
    known, values, sigmas = inverse_distances(hypotheses.expanded)
    used = known & hypotheses.explained & (values > 0)
    return float(np.median(sigmas[used] / values[used])) if used.any() else math.inf
