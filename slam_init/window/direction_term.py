"""The term of the direction: the right motion with a large error of a direction, or of the rotation.

The covariance of the joint fit (Laplace) gives the deviations, the fields of correlated errors integrated out. It knows
noise, focal length and errors that the tracks of a view share. What it does not know widens them: few views, a lens
beyond its prior, moving objects that the fit explains by chance, and residuals that neighbouring tracks share. The map
of a calibrated camera keeps the stated lens, which the fit moves: what that changes adds to both. A zoom and a shift of
each view widen and move the direction, with the probability that the lens changes from view to view.

The covariance of a fit assumes that the errors of the tracks are independent. Where the model does not hold in a part
of the view, the residuals of neighbours have the same direction: a moving object that the fit explains in part, a lens
that the calibration does not describe, a tracker that prefers one side. The sum of N errors of variance 1 with
correlations ``rho_ij`` has the variance ``N + sum rho_ij`` over all pairs. Beyond the neighbourhood the correlations
vanish, so that each variance of a fit is too small by the factor ``1 + sum_j rho_ij``: the sum over the neighbours of a
track, on average.

A forward motion to a plane parallel to the image moves the pixels exactly as a zoom does, and a small rotation moves
them as a shift of the image does. The expansion of a fit shows how far the tracks distinguish them
(:func:`varying_lens`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.correlated_errors import FIELD_SCALES_PX
from slam_init.types.lens import CALIBRATED_SIGMA, PULL_FREEDOM, LensPrior
from slam_init.window.arguments import FIELD_TERMS
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.joint_fit import NEAR_SIGMAS, JointFit
from slam_init.window.kernel import TUKEY_GATES
from slam_init.window.levels import FEW_VIEWS, NEIGHBOURHOOD, SHIFTS, WRONG_DIRECTION_DEG, WRONG_ROTATION_DEG, ZOOMS
from slam_init.window.motion import FittedMotion
from slam_init.window.uncertainty import (
    ExpandedFit,
    MovedByLens,
    direction_by_principal_point_deg,
    direction_sigmas_deg,
    lens_estimate,
    moved_by_lens,
    places_of,
    rotation_sigmas_deg,
    sigma_with_known_lens,
    three_directions,
    two_directions,
)

#: Neighbours that a track is compared with: a moving object holds four tracks or more, or pulls little. The bound is
#: exceeded by chance once in twenty, that many standard deviations beyond the mean.
#: Class: level.
_COMPARED, _BOUND_SIGMAS = 3, 1.645
#: A lens that zooms shifts a view by its optical axis, over the width of the image: half a pixel of 1280.
_NO_SHIFT = 3e-4
#: A zoom is smooth in time, or independent in each view.
_WAYS_TO_ZOOM = 2


@dataclass(frozen=True, eq=False)
class DirectionTerm:
    """How certain the rotation and the directions of the best motion are, and what a map that differs from it adds."""

    #: (V - 1,) Probability that the direction of a view, or its rotation, is wrong: of all views of the best motion but
    #: the first, the pair's own first. A view near the reference has an uncertain direction although its position is
    #: certain, and one that few tracks link to the pair an uncertain rotation.
    of_views: tuple[float, ...]
    #: (V - 1,) Deviations of these directions where they are largest, in degrees.
    sigmas_deg: tuple[float, ...]
    #: (V - 1,) Deviations of these rotations where they are largest, in degrees.
    rotation_sigmas_deg: tuple[float, ...]
    #: The pair's if focal length and distortion were known, and the model of the lens left nothing that neighbouring
    #: tracks share.
    with_known_lens: float
    #: The pair's if no track lies on a moving object, and neighbouring tracks share no errors.
    if_rigid: float
    #: The pair's if the lens does not change from view to view.
    if_lens_fixed: float
    #: The pair's if the lens that a map holds did not move it away from the fit.
    if_lens_right: float
    #: How far the map is from the fit if it follows the expansion. The deviations have that in them.
    moved: MovedByLens
    #: The lens by the best motion.
    lens: LensPrior

    @property
    def of_pair(self) -> float:
        """Probability that the direction of the pair's baseline, or its rotation, is wrong."""
        return self.of_views[0]

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the direction of the pair's baseline where it is largest."""
        return self.sigmas_deg[0]

    @property
    def rotation_sigma_deg(self) -> float:
        """Standard deviation of the pair's rotation where it is largest."""
        return self.rotation_sigmas_deg[0]

    def of_map(self, rotation_deg: float, direction_deg: float) -> tuple[float, DirectionTerm]:
        """What a map whose pair is that far from the fitted one adds to the risk, and the term with its deviations."""
        added = self.added_by_map(0, rotation_deg, direction_deg)
        turned_deg, aside_deg = self._not_expected_deg(0, rotation_deg, direction_deg)
        sigmas_deg = (math.hypot(self.sigma_deg, aside_deg), *self.sigmas_deg[1:])
        rotation_sigmas_deg = (math.hypot(self.rotation_sigma_deg, turned_deg), *self.rotation_sigmas_deg[1:])
        return added, replace(self, sigmas_deg=sigmas_deg, rotation_sigmas_deg=rotation_sigmas_deg)

    def added_by_map(self, view: int, rotation_deg: float, direction_deg: float) -> float:
        """What the direction of a view, or its rotation, adds to the risk in a map that is that far from the fit.

        Which of both is right is not known, so the distance adds to the second moments.

        * ``view``: In the order of :attr:`of_views`.
        """
        turned_deg, aside_deg = self._not_expected_deg(view, rotation_deg, direction_deg)
        rotation_sigma_deg, sigma_deg = self.rotation_sigmas_deg[view], self.sigmas_deg[view]
        in_map = _wrong_by_sigmas(math.hypot(rotation_sigma_deg, turned_deg), math.hypot(sigma_deg, aside_deg))
        return in_map - _wrong_by_sigmas(rotation_sigma_deg, sigma_deg)

    def _not_expected_deg(self, view: int, rotation_deg: float, direction_deg: float) -> tuple[float, float]:
        """The parts of two differences that the lens of the map does not explain."""
        turned_deg, aside_deg = float(self.moved.rotations_deg[view]), float(self.moved.directions_deg[view])
        return (
            math.sqrt(max(rotation_deg**2 - turned_deg**2, 0.0)),
            math.sqrt(max(direction_deg**2 - aside_deg**2, 0.0)),
        )


def direction_term(hypotheses: WindowHypotheses) -> DirectionTerm:
    """The term of the direction of the best motion."""
    best, expanded = hypotheses.motions[0], hypotheses.expanded
    # The map of a calibrated camera keeps the stated lens.
    calibrated = hypotheses.priors.focal_sigma <= CALIBRATED_SIGMA
    optimism, weights = _optimism(hypotheses, best), expanded.scale_weights
    factor = optimism.factor(lens_held=calibrated)
    moved = moved_by_lens(expanded, held=calibrated)
    by_tracks_deg = direction_sigmas_deg(expanded)
    # What the fit does not know widens its deviations, but not that of the principal point with its own prior.
    by_point_deg = direction_by_principal_point_deg(expanded)[:, None]
    of_rest_deg = np.sqrt(np.maximum(by_tracks_deg**2 - by_point_deg**2, 0.0))
    of_fit_deg = np.hypot(factor * of_rest_deg, by_point_deg)
    of_map_deg = np.hypot(of_fit_deg, moved.directions_deg[:, None])
    varying = varying_lens(expanded)
    rotations_of_fit_deg = factor * rotation_sigmas_deg(expanded)
    rotations_deg = np.hypot(rotations_of_fit_deg, moved.rotations_deg)
    rotated = [three_directions(WRONG_ROTATION_DEG, float(deg)) for deg in rotations_deg]
    known_lens = (1.0 if calibrated else sigma_with_known_lens(expanded)) * by_tracks_deg[0]
    # No track lies on a moving object.
    rigid = replace(optimism, objects=0.0).factor(lens_held=calibrated)
    rigid_deg = np.hypot(rigid * by_tracks_deg[0], moved.directions_deg[0])
    lens_right = float(weights @ _with_varying_lens(of_fit_deg[0], varying, 0))
    return DirectionTerm(
        of_views=tuple(
            min(1.0, float(weights @ _with_varying_lens(sigmas_deg, varying, view)) + rotated[view])
            for view, sigmas_deg in enumerate(of_map_deg)
        ),
        sigmas_deg=tuple(float(np.sqrt(weights @ sigmas_deg**2)) for sigmas_deg in of_map_deg),
        rotation_sigmas_deg=tuple(rotations_deg.tolist()),
        with_known_lens=float(weights @ two_directions(WRONG_DIRECTION_DEG, known_lens)),
        if_rigid=float(weights @ _with_varying_lens(rigid_deg, varying, 0)),
        if_lens_fixed=min(1.0, float(weights @ two_directions(WRONG_DIRECTION_DEG, of_map_deg[0])) + rotated[0]),
        if_lens_right=min(1.0, lens_right + three_directions(WRONG_ROTATION_DEG, float(rotations_of_fit_deg[0]))),
        moved=moved,
        lens=lens_estimate(expanded, optimism.factor(lens_held=False)),
    )


def lens_of_best(hypotheses: WindowHypotheses) -> LensPrior:
    """The lens by the best motion."""
    return lens_estimate(hypotheses.expanded, _optimism(hypotheses, hypotheses.motions[0]).factor(lens_held=False))


def _wrong_by_sigmas(rotation_deg: float, direction_deg: float) -> float:
    """Probability that a rotation or a direction with these standard deviations is wrong."""
    aside = float(two_directions(WRONG_DIRECTION_DEG, np.array([direction_deg]))[0])
    return aside + three_directions(WRONG_ROTATION_DEG, rotation_deg)


@dataclass(frozen=True)
class _Optimism:
    """What the covariance does not know, as factors on the variance of the direction. Independent causes add theirs."""

    #: The Laplace approximation is optimistic with few views.
    few_views: float
    #: A focal length or a distortion beyond its prior: it compensates errors that the model does not have.
    pulled_lens: float
    #: Tracks on moving objects that the fit explains by chance, and residuals that neighbouring tracks share.
    objects: float

    def factor(self, *, lens_held: bool) -> float:
        """Factor on the standard deviation; a lens that a map holds has no part in it."""
        return math.sqrt(self.few_views * (1 + (0.0 if lens_held else self.pulled_lens) + self.objects))


def _optimism(hypotheses: WindowHypotheses, best: FittedMotion) -> _Optimism:
    """Factors for what the covariance of the direction does not know."""
    few_views = (1 + FEW_VIEWS / math.sqrt(len(best.rows) - 1)) ** 2
    priors, lens = hypotheses.priors, best.fit.state.lens
    pull2 = ((lens.log_scale - priors.mean.log_scale) / priors.focal_sigma) ** 2
    pull2 += ((lens.k1 - priors.mean.k1) / priors.k1_sigma) ** 2
    # Tracks that stay near without being explained may lie on moving objects. As many again may be explained by chance,
    # and each of these pulls by about half a standard deviation of a track. The variance of their sum is that of pulls
    # in the same direction, times their correlation.
    places, near = places_of(best.fit), best.fit.close_outliers
    pull = 0.5 * float(near.sum()) / math.sqrt(max(best.fit.explained, 1))
    objects = residual_agreement(best.fit, near, places) * pull**2
    # What a fit explains in part leaves residuals that neighbours share.
    shared = variance_by_correlation(best.fit, places)
    return _Optimism(few_views, pull2 / PULL_FREEDOM, objects + shared - 1)


def _with_varying_lens(sigmas_deg: Floats, varying: VaryingLens, view: int) -> Floats:
    """Probability that the direction of a view is wrong, over the modes of a lens that changes from view to view."""
    moments_deg = np.hypot(varying.factors[:, view, None] * sigmas_deg, varying.moved_deg[:, view, None])
    return np.asarray(varying.probabilities @ two_directions(WRONG_DIRECTION_DEG, moments_deg))


# -- errors that neighbouring tracks share -----------------------------------------------------------------------------


def variance_by_correlation(fit: JointFit, places: Floats) -> float:
    """Factor on each variance of a fit for the errors that neighbouring tracks share.

    Shapes: ``places`` (T, 2).

    * Returns: At least 1. Without shared errors it exceeds 1 by chance: with 300 tracks in two views by 0.25, in twelve
      views by 0.1.
    """
    tracks = fit.tracks
    near = _neighbours(places, tracks.anchor >= 0)
    squares = np.einsum("vtq,vtq->vt", fit.residuals, fit.residuals)
    used = tracks.seen & (tracks.anchor >= 0) & (squares < TUKEY_GATES * fit.priors.gate_sigmas**2)
    errors = np.where(used[..., None], fit.residuals, 0.0).transpose(1, 0, 2).reshape(len(places), -1)
    total = float(np.sum(errors**2))
    return 1.0 + max(float(np.sum(errors * (near @ errors))) / total, 0.0) if total > 0 else 1.0


def residual_agreement(fit: JointFit, of: Bools, places: Floats) -> float:
    """How far the residuals of some tracks agree with those of their neighbours among them: at most, from 0 to 1.

    Tracks on a moving object agree (0.7 to 1), wrong matches and tracks with more noise than others do not.

    Shapes: ``of`` (T,), ``places`` (T, 2).
    """
    index = np.flatnonzero(of)
    if len(index) <= _COMPARED:
        return 1.0
    squares = np.einsum("vtq,vtq->tv", fit.residuals[:, index], fit.residuals[:, index])
    used = fit.tracks.seen[:, index].T & (squares < NEAR_SIGMAS**2)
    errors = np.where(used[..., None], fit.residuals[:, index].transpose(1, 0, 2), 0.0)
    # Of two tracks the views count that see both.
    lengths = np.sqrt(np.where(used, squares, 0.0) @ used.T.astype(float))
    cosines = np.einsum("ivq,jvq->ij", errors, errors) / np.maximum(lengths * lengths.T, 1e-300)
    of_track = np.take_along_axis(cosines, _nearest(places[index], _COMPARED), axis=1).mean(axis=1)
    bound = float(of_track.mean() + _BOUND_SIGMAS * of_track.std() / np.sqrt(len(index)))
    return min(max(bound, 0.0), 1.0)


def _neighbours(places: Floats, used: Bools) -> Floats:
    """(T, T) ones where the second track is among the nearest of the first."""
    near = np.zeros((len(places), len(places)))
    index = np.flatnonzero(used)
    count = min(max(round(NEIGHBOURHOOD * len(index)), 1), len(index) - 1)
    if count < 1:
        return near
    near[index[:, None], index[_nearest(places[index], count)]] = 1.0
    return near


def _nearest(places: Floats, count: int) -> Ints:
    """The rows (N, count) of the places that are nearest to each place (N, 2)."""
    x, y = places.T
    squares = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    np.fill_diagonal(squares, np.inf)
    return np.argpartition(squares, count - 1, axis=1)[:, :count]


# -- a lens that changes from view to view -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class VaryingLens:
    """Whether the lens is the same in all views, and how certain the directions are if it is not."""

    #: (M + 1,) Logarithms of the weights: that the lens is the same, then that it zooms, then that views are shifted.
    log_weights: Floats
    #: (M + 1, V - 1) Factors on the standard deviations of the directions; 1 if the lens is the same.
    factors: Floats
    #: (M + 1, V - 1) How far the directions move; 0 if the lens is the same.
    moved_deg: Floats

    @property
    def probabilities(self) -> Floats:
        """Probability that the lens is the same, then of each mode.

        Shapes: returns (M + 1,).
        """
        weights = np.exp(self.log_weights - self.log_weights.max())
        return np.asarray(weights / weights.sum())


def varying_lens(expanded: ExpandedFit) -> VaryingLens:
    """What a zoom and a shift of each view explain of the tracks, and what they change about the directions.

    The expansion of the fit gives both: the gradient of the cost by the zooms and the shifts, and their information.
    The first view has none, as what all views have in common is the lens. The fields have their likeliest scale.
    """
    lin, tracks, lens_changes = expanded.linearization, expanded.fit.tracks, expanded.fit.priors.lens_changes
    views = len(expanded.fit.state.R)
    other, field, H = ~lin.is_field, lin.is_field, lin.information
    known = H[np.ix_(other, other)] + 1e-9 * np.eye(int(other.sum()))
    units = np.sqrt(np.maximum(np.diag(known), 1e-300))
    covariance = np.linalg.inv(known / np.outer(units, units)) / np.outer(units, units)
    follow = covariance @ H[np.ix_(other, field)]
    left = H[np.ix_(field, field)] - H[np.ix_(field, other)] @ follow
    gradient = lin.gradient[field] - follow.T @ lin.gradient[other]
    scale_px = float(FIELD_SCALES_PX[int(np.argmax(expanded.scale_weights))])
    given = np.zeros_like(left)
    if scale_px:
        given = np.linalg.inv(0.5 * (left + left.T) + np.eye(len(left)) / scale_px**2)
    # Given a zoom or a shift, the fields take a part of it back.
    alone = zooms_and_shifts(tracks.camera, views)
    B = alone - given @ (left @ alone)
    information, gradient = B.T @ left @ alone, B.T @ gradient
    gradient[::3] += shrunk_noise(expanded.fit)
    J, along = expanded.directions, expanded.directions @ follow
    fixed = J @ covariance @ np.swapaxes(J, 1, 2) + along @ given @ np.swapaxes(along, 1, 2)
    by_mode, largest_fixed = along @ B, np.maximum(np.linalg.eigvalsh(fixed)[:, -1], 1e-300)
    log_weights = [math.log(1 - lens_changes * sum(prior for _, prior in (*ZOOMS, *SHIFTS)))]
    factors, moved_deg = [np.ones(views - 1)], [np.zeros(views - 1)]
    for root, prior in _modes(tracks.camera, tracks.times_s) if lens_changes else ():
        scaled = root.T @ (0.5 * (information + information.T)) @ root + np.eye(len(root))
        posterior = root @ np.linalg.inv(scaled) @ root.T
        mean = -posterior @ gradient
        evidence = 0.5 * float(gradient @ posterior @ gradient) - 0.5 * float(np.linalg.slogdet(scaled)[1])
        log_weights.append(math.log(lens_changes * prior) + evidence)
        moved = by_mode @ posterior @ np.swapaxes(by_mode, 1, 2)
        factors.append(np.sqrt(np.maximum(np.linalg.eigvalsh(fixed + moved)[:, -1] / largest_fixed, 1.0)))
        moved_deg.append(np.degrees(np.linalg.norm(by_mode @ mean, axis=1)))
    return VaryingLens(np.array(log_weights), np.array(factors), np.array(moved_deg))


def _modes(camera: Camera, times_s: Floats) -> Iterator[tuple[Floats, float]]:
    """How a lens may change: roots (3 V - 3, 3 V - 3) of the prior covariances of all views, and their probabilities.

    A lens that focuses zooms smoothly, or it has settled again in each view: both are alike probable. Independent zooms
    alone would let a slow zoom pay for as many unknowns as there are views, so that it would be less likely than none.
    A stabilizer moves each frame for itself.
    """
    smooth, settled = np.asarray(np.linalg.cholesky(zoom_covariance(times_s))), np.eye(len(times_s) - 1)
    for zoom, prior in ZOOMS:
        for root in (smooth, settled):
            yield _root(zoom * root, _NO_SHIFT * camera.width), prior / _WAYS_TO_ZOOM
    for shift, prior in SHIFTS:
        yield _root(shift / 3 * settled, shift * camera.width), prior


def _root(of_zooms: Floats, shift_px: float) -> Floats:
    """The root (3 V - 3, 3 V - 3) of the prior covariance of zooms and of shifts that are independent."""
    root = np.kron(np.eye(len(of_zooms)), np.diag([0.0, shift_px, shift_px]))
    root[::3, ::3] = of_zooms
    return np.asarray(root)


def zoom_covariance(times_s: Floats) -> Floats:
    """Covariance of the zooms of all views but the first, over that of the first, of a lens with a deviation of 1.

    How a zoom proceeds in time is not known: it is a smooth random function (Matern 3/2), with the length of the window
    as its scale.

    Shapes: ``times_s`` (V,), returns (V - 1, V - 1).
    """
    spans = np.abs(times_s[:, None] - times_s[None])
    apart = math.sqrt(3) * spans / max(float(spans.max()), 1e-9)
    smooth = (1 + apart) * np.exp(-apart)
    from_first = smooth - smooth[:, :1] - smooth[:1] + smooth[0, 0]
    # A view at the time of another one has a zoom of its own, however small.
    return np.asarray(from_first[1:, 1:] + 1e-6 * np.eye(len(times_s) - 1))


def shrunk_noise(fit: JointFit) -> Floats:
    """What the gradient by the zoom of each view but the first lacks, where fields describe the zooms.

    The fields are polynomials of the measured pixels. A zoom of these shrinks their noise as well: with N tracks in a
    view the gradient has an expectation of -2 N. A lens zooms the projections, which are a residual away.

    Shapes: returns (V - 1,).
    """
    tracks, squares = fit.tracks, np.sum(fit.residuals**2, axis=2)
    left_of_gate = np.maximum(1 - squares / (TUKEY_GATES * fit.priors.gate_sigmas**2), 0.0)
    used = tracks.seen & (tracks.anchor >= 0) & (left_of_gate > 0)
    return np.asarray(np.sum(left_of_gate**2 * np.where(used, squares, 0.0), axis=1)[1:])


def zooms_and_shifts(camera: Camera, views: int) -> Floats:
    """The coefficients (12 V, 3 V - 3) of the fields by the zoom and the shift (x, y) of each view but the first."""
    own = np.zeros((FIELD_TERMS, 3))
    half = FIELD_TERMS // 2
    # The linear terms have a mean square of 1 over the image.
    own[1, 0], own[half + 2, 0] = (camera.width - 1) / math.sqrt(12), (camera.height - 1) / math.sqrt(12)
    own[0, 1] = own[half, 2] = 1.0
    return np.asarray(np.kron(np.eye(views)[:, 1:], own), np.float64)
