"""The term *rotation* of the risk: the probability that the camera only rotates.

Translation and points add unknowns, so they lower the cost by chance: twice the gain has a chi-square distribution
then. A tracker keeps errors from view to view, which scale the gain or, where that decides more, join the noise. A
camera that only rotates may have images that zoom and shift (:mod:`~slam_init.window.zooming_rotation`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.lens import LensPrior
from slam_init.window.hypotheses import CERTAIN_SIGMAS, EXPLAINED_BY_FIELDS, WindowHypotheses, with_rotation_refitted
from slam_init.window.levels import (
    CHANCE_GAIN,
    EVEN_ODDS,
    FLOOR,
    LENS_ZOOMS,
    ON_OBJECTS,
    SHARE_OF_OBJECTS,
    UNDECIDED,
    ZOOM_LEAVES,
    ZOOMS,
)
from slam_init.window.linearization import linearize_with_fields, marginalize_fields
from slam_init.window.motion import fit_motion
from slam_init.window.tracks import (
    gain_of_lasting_errors,
    gain_of_shared_errors,
    gain_of_turning_errors,
    with_lasting_errors,
)
from slam_init.window.uncertainty import ExpandedFit, at_any_time, chi_square_as_gaussian, lens_estimate
from slam_init.window.zooming_rotation import ZoomingRotation, with_zooms

#: Errors whose variance adds as much to that of the noise, as a factor on it. Smaller ones scale what chance gains by
#: about as much as they do in the noise.
#: Class: geometry.
_LARGER_THAN_NOISE = 2.0
#: Errors of a smaller share of the noise change it by less than a twentieth.
#: Class: geometry.
_OF_NOISE = 0.3


class RotationTerm(NamedTuple):
    """The term of the camera that only rotates."""

    #: Log likelihood of the best motion over it, in nats.
    gain: float
    #: Of a gain as large, if the camera only rotates.
    probability: float
    #: Its lens, where it is likely.
    lens: LensPrior | None
    #: Whether the errors that a tracker keeps were taken for noise.
    lasting_in_noise: bool = False


def rotation_term(hypotheses: WindowHypotheses, direction: float) -> RotationTerm:
    """The term of the rotation-only camera: with a wrong focal length, lasting errors, or moving objects.

    * ``direction``: The term of the direction.
    """
    term = rotation_probability(hypotheses, hypotheses.expanded)
    # Another test takes two fits, which a direction that is unknown is not worth.
    if term.probability > FLOOR and direction <= UNDECIDED and keeps_errors(hypotheses):
        wide = with_errors_in_noise(hypotheses)
        of_wide = rotation_probability(wide, wide.expanded, lasting_in_noise=True).probability
        of_wide = max(of_wide, _beside_objects(wide))
        term = term._replace(probability=min(of_wide, term.probability), lasting_in_noise=of_wide < term.probability)
    return term._replace(probability=max(term.probability, _beside_objects(hypotheses)))


def _beside_objects(hypotheses: WindowHypotheses) -> float:
    """Probability of the camera that only rotates beside moving objects.

    Points at infinity lie on no plane, so that a plane needs no such test.
    """
    return 0.0 if hypotheses.planar else moving_objects_probability(hypotheses, ON_OBJECTS)


def rotation_probability(
    hypotheses: WindowHypotheses, expanded: ExpandedFit, unexplained: float = 0.0, *, lasting_in_noise: bool = False
) -> RotationTerm:
    """The term without moving objects, by one model of the errors that a tracker keeps.

    * ``unexplained``: What the model of that camera leaves, in nats.
    * ``lasting_in_noise``: Of hypotheses of :func:`with_errors_in_noise`.
    """
    gain, freedom = hypotheses.gain_over_rotation
    gain -= unexplained
    tracks, state = hypotheses.tracks, hypotheses.rotation_only.state
    lasting = 1.0 if lasting_in_noise else gain_of_lasting_errors(tracks, state.R)
    dispersion = lasting * hypotheses.motions[0].fit.dispersion
    # Shared errors make the distribution a noncentral one, which is that of Patnaik nearly: a scaled chi-square.
    shared = gain_of_shared_errors(tracks) + gain_of_turning_errors(tracks, state.lens.readout_s)
    scale = (freedom + 2 * shared) / (freedom + shared)
    freedom = (freedom + shared) / scale

    def z_of(gains: Floats) -> Floats:
        return chi_square_as_gaussian(2 * gains / (scale * freedom), freedom)

    if z_of(np.array([(1 - EXPLAINED_BY_FIELDS) * max(gain, 0.0) / dispersion]))[0] > CERTAIN_SIGMAS:
        return RotationTerm(gain, 0.0, None)
    rotation = linearize_with_fields(hypotheses.rotation_only)
    marginal = marginalize_fields(rotation)
    explained = marginal.lowered_cost - expanded.marginal.lowered_cost
    gains = np.maximum(gain - 0.5 * np.maximum(explained, 0.0), 0.0) / dispersion
    probability = float(expanded.scale_weights @ [at_any_time(float(one)) for one in z_of(gains)])
    likely = probability > EVEN_ODDS
    lens = lens_estimate(ExpandedFit(hypotheses.rotation_only, rotation, marginal)) if likely else None
    return RotationTerm(gain, probability, lens)


def keeps_errors(hypotheses: WindowHypotheses) -> bool:
    """Whether the errors that a tracker keeps may be larger than the noise."""
    return gain_of_lasting_errors(hypotheses.tracks, hypotheses.rotation_only.state.R) > _LARGER_THAN_NOISE


def with_errors_in_noise(hypotheses: WindowHypotheses) -> WindowHypotheses:
    """The best motion, and the camera that only rotates, with the errors that a tracker keeps in the noise.

    An outlier gains 4.5 nats at the most. What chance gains grows with the square of the errors, beyond what even
    outliers gain where the noise is a third of them: then two views would show no translation. With the errors
    in the noise, a track whose parallax they explain is no outlier, and one whose parallax is larger stays one.
    """
    tracks, best = hypotheses.tracks, hypotheses.motions[0]
    wide = with_lasting_errors(tracks, hypotheses.rotation_only.state.R)
    again = fit_motion(wide, best.motion, hypotheses.priors)
    return with_rotation_refitted(replace(hypotheses, tracks=wide, motions=(again,)))


def moving_objects_probability(hypotheses: WindowHypotheses, share: float, price: float = 0.0) -> float:
    """Probability of the gains over the rotation-only camera if this share of the tracks, which gain most, moves.

    Before a camera that only rotates, a moving object looks like a near object before points at infinity.

    * ``price``: A part of the gain that no track is needed for, in twice the nats.
    """
    best, explained = hypotheses.motions[0], hypotheses.explained
    gains = (hypotheses.rotation_only.track_costs - hypotheses.costs_of(best))[explained]
    count = len(gains) - int(share * len(gains))
    if not count:
        return 1.0
    by_chance, sigma = CHANCE_GAIN * count, math.sqrt(2 * count)
    least = float(np.partition(gains, count - 1)[:count].sum())
    return at_any_time(((price + least) / best.fit.dispersion - by_chance) / sigma)


def zooming_probability(hypotheses: WindowHypotheses) -> float:
    """Probability that the camera only rotates, and that its images zoom or shift.

    The errors that a tracker keeps scale the gain, or are in the noise where they may be larger than it.
    """
    # It is not worth its fits where even a certain zoom would be no more than what is not modelled.
    if hypotheses.priors.lens_changes * LENS_ZOOMS <= FLOOR:
        return 0.0
    probability = _probability_beside_zooms(hypotheses)
    if probability > FLOOR and keeps_errors(hypotheses):
        wide = with_errors_in_noise(hypotheses)
        probability = min(probability, _probability_beside_zooms(wide, lasting_in_noise=True))
    return probability


def _probability_beside_zooms(hypotheses: WindowHypotheses, *, lasting_in_noise: bool = False) -> float:
    """The same by one model of the errors that a tracker keeps.

    See :func:`rotation_probability` for ``lasting_in_noise``.
    """
    zoomed = with_zooms(hypotheses)
    explained = 0.5 * (hypotheses.rotation_only.cost - zoomed.hypotheses.rotation_only.cost)
    # A zoom looks like a motion toward a plane, so that a few moving objects before it look like its depth variation.
    # Tracks that lie on a plane are no such moving objects.
    objects = explained > zoomed.hypotheses.gain_over_rotation[0] and not hypotheses.planar
    # What the model of a zoom lacks is a share of what it explains. Where outliers bound that, it is in the noise.
    has_zooms = float(np.abs(zoomed.zooms).max()) > ZOOMS[0][0]
    cases = [(hypotheses, zoomed, ZOOM_LEAVES * explained if has_zooms else 0.0)]
    # A camera over which the best motion gains nothing is as probable as it can be.
    gains = zoomed.hypotheses.gain_over_rotation[0] > 0
    if gains and (wide := _with_errors_of_zooms(hypotheses, zoomed)) is not None:
        cases.append((*wide, 0.0))
    probability = 0.0
    for one, zoom, unexplained in cases:
        # A wrong match, which both explain in part, costs a camera more that starts farther away. Before a plane, where
        # a zoom and a motion explain the same, these would decide.
        beyond = zoom.hypotheses.gain_beyond_votes if one.planar else 0.0
        by_gain = rotation_probability(
            zoom.hypotheses, one.expanded, unexplained + beyond, lasting_in_noise=lasting_in_noise
        ).probability
        by_objects = moving_objects_probability(zoom.hypotheses, SHARE_OF_OBJECTS, price=zoom.price) if objects else 0.0
        probability = max(probability, by_gain, by_objects)
    return hypotheses.priors.lens_changes * LENS_ZOOMS * probability


def _with_errors_of_zooms(
    hypotheses: WindowHypotheses, zoomed: ZoomingRotation
) -> tuple[WindowHypotheses, ZoomingRotation] | None:
    """Both with what the zooms of a lens leave of their displacements in the noise; None where that changes nothing.

    Otherwise a motion straight toward a frontal plane, which explains the zooms too, would gain by what the model of a
    zoom lacks.
    """
    tracks, best = hypotheses.tracks, hypotheses.motions[0]
    errors_px = zoomed.errors_px(tracks, hypotheses.priors)
    if not (errors_px > _OF_NOISE * tracks.sigma_px).any():
        return None
    wide = replace(tracks, sigma_px=np.hypot(tracks.sigma_px, errors_px))
    hypotheses = replace(hypotheses, tracks=wide, motions=(fit_motion(wide, best.motion, hypotheses.priors),))
    return hypotheses, zoomed.beside(hypotheses)
