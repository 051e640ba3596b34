"""The risk that a map of the window's best hypothesis is wrong, and the terms that it is composed of.

Wrong means: a rotation off by more than 5 degrees, or a direction of the baseline off by more than 15 degrees. Five
causes add their probabilities:

* **direction**: the right hypothesis with a large error of the direction, or of the rotation. The covariance of the
  joint fit (Laplace) gives their standard deviations, the error fields integrated out. It knows noise, focal length and
  errors that the tracks of a view share. Errors that a track keeps over many views, and noise that differs between
  tracks, show in the scatter of the scores; for the direction the larger deviation counts. The map of a calibrated
  camera keeps the stated lens, which the fit moves: what that changes adds to both. A zoom and a shift of each view
  widen and move the direction, with the probability that the lens changes from view to view. Before a map is accepted,
  a motion with any zoom of each view is fitted too (:mod:`~slam_init.window.zooming_motion`).
* **rival**: another motion is right. Each track votes by the difference of its two log likelihoods, by three nats at
  the most: so much it costs to say that the track is an outlier. The image region with the largest vote is left out,
  since a moving body or a step in the scene fills a region. What the error fields explain of the rival counts for it.
* **rotation**: the camera only rotates, with a wrong focal length, and translation and points gain by chance; or its
  images zoom and shift besides (:mod:`~slam_init.window.rotation_term`); or up to half of the tracks lie on bodies that
  move (:mod:`~slam_init.window.half_at_rest`).
* **moving**: the tracks that the best motion does not explain have a rigid motion of their own, and they may be the
  scene at rest (:mod:`~slam_init.window.other_motion`); or a body holds the best motion, and the half of the view
  without it prefers another one (:mod:`~slam_init.window.left_out`).
* **floor**: what is not modelled.

A window is judged at each frame: tails hold for any stopping time (:mod:`~slam_init.window.tails`). A small risk is
looked at again (:mod:`~slam_init.window.confirmation`). ``docs/how/risk.md`` derives all of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from slam_init.system.linear_algebra import deviations, single_threaded
from slam_init.types.arrays import Floats
from slam_init.types.evidence import Margin
from slam_init.types.lens_in_use import CALIBRATED_SIGMA, PULL_FREEDOM
from slam_init.window.half_at_rest import bodies_probability
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import (
    BODIES_MOVE,
    EVEN_ODDS,
    FEW_VIEWS,
    FLOOR,
    ON_BODIES,
    SHARE_OF_BODIES,
    UNDECIDED,
    WRONG_DIRECTION_DEG,
    WRONG_ROTATION_DEG,
)
from slam_init.window.motion import FittedMotion, OtherMotion
from slam_init.window.neighbours import agreement_of_neighbours, variance_by_neighbours
from slam_init.window.other_motion import explained_tracks, other_motion
from slam_init.window.rival import rival_term
from slam_init.window.rotation_term import (
    keeps_errors,
    rotation_probability,
    with_errors_in_noise,
)
from slam_init.window.tails import three_directions, two_directions
from slam_init.window.uncertainty import (
    CameraEstimate,
    MovedByLens,
    VaryingLens,
    camera_estimate,
    direction_by_principal_point_deg,
    direction_sigmas_deg,
    expand,
    inverse_distances,
    moved_by_lens,
    places_of,
    rotation_covariance,
    sigma_with_known_lens,
    varying_lens,
)


@dataclass(frozen=True)
class WindowRisk:
    """The probability that a map of the best hypothesis is wrong, with its terms."""

    #: Sum of the terms, at most 1.
    total: float
    #: direction, rival, rotation, floor: Probabilities, see the module docstring; ``moving`` is that of ``other``.
    direction: float
    rival: float
    rotation: float
    floor: float
    #: Standard deviation of the direction of the pair's baseline where it is largest.
    direction_sigma_deg: float
    #: Standard deviation of the pair's rotation where it is largest.
    rotation_sigma_deg: float
    #: The term of the direction if focal length and distortion were known, and the model of the lens left nothing
    #: that neighbouring tracks share.
    direction_with_known_lens: float
    #: The term of the direction if no track lies on a moving body, and neighbouring tracks share no errors.
    direction_if_rigid: float
    #: The term of the direction if the lens does not change from view to view.
    direction_if_lens_fixed: float
    #: The term of the direction if the lens that a map holds did not move it away from the fit.
    direction_if_lens_right: float
    #: Median of the relative standard deviations of the distances from the reference, in units of the pair's
    #: baseline, over the tracks that the best motion explains. The landmarks of a map have figures of their own.
    depth_sigma: float
    #: Expected standard deviation of the coefficients of the error fields.
    field_px: float
    #: The focal length, the distortion and the readout by the best motion, or by the camera that only rotates where
    #: that is likely.
    camera: CameraEstimate
    #: Probability that each view is shifted as a whole.
    frames_are_shifted: float
    #: The vote against the nearest rival; None without a rival.
    margin: Margin | None
    #: Log likelihood of the best motion over the rotation-only camera, in nats.
    rotation_log_likelihood: float
    #: The term of the direction for each view of the best motion but the first: the pair's own first. A view near the
    #: reference has an uncertain direction although its position is certain. Few tracks may lie on a body, or on a
    #: texture that repeats.
    direction_of_views: tuple[float, ...]
    #: Deviations of these directions where they are largest, in degrees.
    sigmas_of_views_deg: tuple[float, ...]
    #: How far the map is from the fit if it follows the expansion: the lens that a map holds moves it. The deviations
    #: have that in them.
    moved: MovedByLens
    #: Whether the camera that only rotates was tested with the errors that a tracker keeps in the noise.
    lasting_in_noise: bool
    #: The motion of the tracks that the best motion does not explain; none where the camera merely rotates.
    other: OtherMotion
    #: Of :func:`slam_init.window.left_out.wrong_by_a_half`; 0 before a second look.
    by_a_half: float = field(default=0.0, kw_only=True)

    @property
    def moving(self) -> float:
        """The term of bodies: of another motion, or of one that holds the best motion."""
        return min(1.0, self.other.probability + self.by_a_half)

    def of_map(self, rotation_deg: float, direction_deg: float) -> WindowRisk:
        """The risk of a map whose pair is that far from the fitted one."""
        added = self.added_by_map(0, rotation_deg, direction_deg)
        turned_deg, aside_deg = self._not_expected_deg(0, rotation_deg, direction_deg)
        return replace(
            self,
            total=min(1.0, self.total + added),
            direction=min(1.0, self.direction + added),
            rotation_sigma_deg=math.hypot(self.rotation_sigma_deg, turned_deg),
            direction_sigma_deg=math.hypot(self.direction_sigma_deg, aside_deg),
        )

    def added_by_map(self, view: int, rotation_deg: float, direction_deg: float) -> float:
        """What the direction of a view, or its rotation, adds to the risk in a map that is that far from the fit.

        Which of both is right is not known, so the distance adds to the second moments.

        * ``view``: In the order of :attr:`direction_of_views`.
        """
        turned_deg, aside_deg = self._not_expected_deg(view, rotation_deg, direction_deg)
        sigma_deg = self.sigmas_of_views_deg[view]
        stated = _wrong_by_sigmas(self.rotation_sigma_deg, sigma_deg)
        return (
            _wrong_by_sigmas(math.hypot(self.rotation_sigma_deg, turned_deg), math.hypot(sigma_deg, aside_deg)) - stated
        )

    def _not_expected_deg(self, view: int, rotation_deg: float, direction_deg: float) -> tuple[float, float]:
        """The parts of two differences that the lens of the map does not explain."""
        turned_deg, aside_deg = self.moved.rotation_deg, float(self.moved.directions_deg[view])
        return (
            math.sqrt(max(rotation_deg**2 - turned_deg**2, 0.0)),
            math.sqrt(max(direction_deg**2 - aside_deg**2, 0.0)),
        )


def _wrong_by_sigmas(rotation_deg: float, direction_deg: float) -> float:
    """Probability that a rotation or a direction with these standard deviations is wrong."""
    aside = float(two_directions(WRONG_DIRECTION_DEG, np.array([direction_deg]))[0])
    return aside + three_directions(WRONG_ROTATION_DEG, rotation_deg)


def risk_of(hypotheses: WindowHypotheses, max_risk: float = 1.0) -> WindowRisk:
    """Compose the risk of the best hypothesis; above ``max_risk`` the terms of rivals and bodies are lower bounds."""
    with single_threaded():
        return _risk_of(hypotheses, max_risk)


def _risk_of(hypotheses: WindowHypotheses, max_risk: float = 1.0) -> WindowRisk:
    best = hypotheses.motions[0]
    expanded = expand(hypotheses, best)
    calibrated = hypotheses.priors.focal_sigma <= CALIBRATED_SIGMA
    optimism = _optimism(hypotheses, best)
    factor, weights = optimism.factor(lens_held=calibrated), expanded.scale_weights
    # The map of a calibrated camera keeps the stated lens.
    moved = moved_by_lens(expanded, hypotheses.priors, held=calibrated)
    by_tracks_deg = direction_sigmas_deg(expanded)
    # What the fit does not know widens its deviations, but not that of the principal point with its own prior.
    by_point_deg = direction_by_principal_point_deg(expanded)[:, None]
    of_fit = _widened(by_tracks_deg, factor, by_point_deg)
    of_views = np.hypot(of_fit, moved.directions_deg[:, None])
    varying = varying_lens(expanded, hypotheses.priors)
    rotation_of_fit_deg = factor * _largest_sigma_deg(rotation_covariance(expanded))
    rotation_deg = math.hypot(rotation_of_fit_deg, moved.rotation_deg)
    rotated = three_directions(WRONG_ROTATION_DEG, rotation_deg)
    held = _held_by_bodies(best)
    direction_risks = tuple(
        min(1.0, float(weights @ _with_varying_lens(sigmas_deg, varying, view)) + rotated + held[view])
        for view, sigmas_deg in enumerate(of_views)
    )
    sigmas_of_views = tuple(float(np.sqrt(weights @ sigmas_deg**2)) for sigmas_deg in of_views)
    direction, direction_deg = direction_risks[0], sigmas_of_views[0]
    known_lens = (1.0 if calibrated else sigma_with_known_lens(expanded)) * by_tracks_deg[0]
    with_known_lens = float(weights @ two_directions(WRONG_DIRECTION_DEG, known_lens))
    rigid_deg = np.hypot(optimism.if_rigid(lens_held=calibrated) * by_tracks_deg[0], moved.directions_deg[0])
    if_rigid = float(weights @ _with_varying_lens(rigid_deg, varying, 0))
    if_lens_fixed = min(1.0, float(weights @ two_directions(WRONG_DIRECTION_DEG, of_views[0])) + rotated)
    if_lens_right = float(weights @ _with_varying_lens(of_fit[0], varying, 0))
    if_lens_right = min(1.0, if_lens_right + three_directions(WRONG_ROTATION_DEG, rotation_of_fit_deg))
    gain, rotation, camera = rotation_probability(hypotheses, expanded)
    if rotation <= EVEN_ODDS:
        camera = camera_estimate(expanded, optimism.factor(lens_held=False))
    # Another test takes two fits, which a direction that is unknown is not worth.
    lasting_in_noise = rotation > FLOOR and direction <= UNDECIDED and keeps_errors(hypotheses)
    if lasting_in_noise:
        wide = with_errors_in_noise(hypotheses)
        of_wide = rotation_probability(wide, expand(wide, wide.motions[0]), lasting_in_noise=True)[1]
        of_wide = max(of_wide, 0.0 if wide.planar else bodies_probability(wide, ON_BODIES))
        lasting_in_noise, rotation = of_wide < rotation, min(of_wide, rotation)
    # Points at infinity lie on no plane, so that a plane needs no such test.
    rotation = max(rotation, 0.0 if hypotheses.planar else bodies_probability(hypotheses, ON_BODIES))
    # A window that has no map without the terms of rivals and bodies is not worth their fits.
    refused = rotation > UNDECIDED or direction > UNDECIDED
    other = OtherMotion() if refused else other_motion(hypotheses, rotation_deg, direction_deg)
    if hypotheses.body is not None and hypotheses.body.probability >= other.probability:
        other = hypotheses.body
    left = max_risk - total_of(direction, 0.0, rotation, other.probability)
    rival, nearest = rival_term(hypotheses, expanded, direction_deg, most=-1.0 if refused else min(left, UNDECIDED))
    total = total_of(direction, rival, rotation, other.probability)
    distances = inverse_distances(expanded)
    explained = replace(distances, known=distances.known & explained_tracks(hypotheses))
    depth_sigmas = explained.relative_sigmas
    field_px = expanded.marginal.expected_scale_px(expanded.scale_weights)
    return WindowRisk(
        total=total,
        direction=direction,
        direction_with_known_lens=with_known_lens,
        direction_if_rigid=if_rigid,
        direction_if_lens_fixed=if_lens_fixed,
        direction_if_lens_right=if_lens_right,
        direction_of_views=direction_risks,
        sigmas_of_views_deg=sigmas_of_views,
        moved=moved,
        rival=rival,
        rotation=rotation,
        lasting_in_noise=lasting_in_noise,
        other=other,
        floor=FLOOR,
        direction_sigma_deg=direction_deg,
        rotation_sigma_deg=rotation_deg,
        depth_sigma=float(np.median(depth_sigmas)) if len(depth_sigmas) else math.inf,
        field_px=field_px,
        frames_are_shifted=varying.shifted,
        margin=nearest,
        rotation_log_likelihood=gain,
        camera=camera,
    )


def total_of(direction: float, rival: float, rotation: float, moving: float) -> float:
    """The risk: the causes add their probabilities."""
    return min(1.0, direction + rival + rotation + moving + FLOOR)


@dataclass(frozen=True)
class _Optimism:
    """What the covariance does not know, as factors on the variance of the direction. Independent causes add theirs."""

    #: The Laplace approximation is optimistic with few views.
    few_views: float
    #: A focal length or a distortion beyond its prior: it compensates errors that the model does not have.
    pulled_lens: float
    #: Tracks on bodies that the fit explains by chance, and residuals that neighbouring tracks share.
    bodies: float

    def factor(self, *, lens_held: bool) -> float:
        """Factor on the standard deviation; a lens that a map holds has no part in it."""
        return math.sqrt(self.few_views * (1 + (0.0 if lens_held else self.pulled_lens) + self.bodies))

    def if_rigid(self, *, lens_held: bool) -> float:
        """Factor on the standard deviation if no track lies on a moving body."""
        return replace(self, bodies=0.0).factor(lens_held=lens_held)


def _optimism(hypotheses: WindowHypotheses, best: FittedMotion) -> _Optimism:
    """Factors for what the covariance of the direction does not know."""
    few_views = (1 + FEW_VIEWS / math.sqrt(len(best.rows) - 1)) ** 2
    pull2 = sum(pull**2 for pull in hypotheses.priors.lens_pulls(best.fit.state))
    # Tracks that stay near without being explained may lie on moving bodies. As many again may be explained by chance,
    # and each of these pulls by about half a standard deviation of a track. The variance of their sum is that of pulls
    # in the same direction, times their correlation.
    places, near = places_of(best.fit), best.fit.near_misses
    pull = 0.5 * float(near.sum()) / math.sqrt(max(best.fit.explained, 1))
    bodies = agreement_of_neighbours(best.tracks, best.fit, near, places) * pull**2
    # What a fit explains in part leaves residuals that neighbours share.
    shared = variance_by_neighbours(best.tracks, best.fit, hypotheses.priors, places)
    return _Optimism(few_views, pull2 / PULL_FREEDOM, bodies + shared - 1)


def _held_by_bodies(best: FittedMotion) -> Floats:
    """Probability (V - 1,) that a body, or a texture that repeats, locates a view: that of a body, where few tracks do.

    Few are fewer than a body holds. Before a corridor whose panels repeat, 18 of the 122 tracks of a pair agreed on a
    pose of a further view that was off by 4 degrees. The tracks of the pair itself locate its second view.
    """
    locating = np.count_nonzero(best.tracks.seen & best.fit.explains, axis=1)[1:]
    few = locating < SHARE_OF_BODIES * best.fit.explained
    few[0] = False
    return np.where(few, BODIES_MOVE, 0.0)


def _widened(sigmas_deg: Floats, factor: float, fixed_deg: Floats) -> Floats:
    """Standard deviations with a factor on all but a part that has a deviation of its own."""
    return np.asarray(np.hypot(factor * np.sqrt(np.maximum(sigmas_deg**2 - fixed_deg**2, 0.0)), fixed_deg))


def _with_varying_lens(sigmas_deg: Floats, varying: VaryingLens, view: int) -> Floats:
    """Probability that the direction of a view is wrong, over the modes of a lens that changes from view to view."""
    moments_deg = np.hypot(varying.factors[:, view, None] * sigmas_deg, varying.moved_deg[:, view, None])
    return np.asarray(varying.probabilities @ two_directions(WRONG_DIRECTION_DEG, moments_deg))


def _largest_sigma_deg(covariance: Floats) -> float:
    """Standard deviation where it is largest, in degrees, of a covariance in rad^2."""
    return math.degrees(float(deviations(np.linalg.eigvalsh(covariance))[-1]))
