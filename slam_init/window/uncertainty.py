"""The uncertainty of a fitted motion: of its rotations, of the directions of its baselines, and of its distances.

The quadratic expansion of the cost (Laplace) gives the covariance of linear functions of the unknowns. The fields of
correlated errors are integrated out, for each of their scales and then over the scales. The expansion counts
information that the errors of the distances make by chance; it is left out
(:func:`slam_init.window.linearization.information_by_chance`). All covariances are second moments about the fit: the
fit has no fields, so the mean of the posterior may differ from it.

Images do not determine the scale of a map, and the fit holds the longest baseline. A function has a meaning only if a
change of the scale does not change it. Rotations and directions are such functions. An inverse distance ``rho`` is
none, but its product with the length of the pair's baseline is: it is the inverse distance in units of that baseline.
With the unit vector ``u`` along the translation ``t`` of the pair ::

    d(rho |t|) = |t| d(rho) + rho u . dt

The covariance of such functions does not depend on which baseline is held.

**Tails.** Windows are evaluated at nearly each frame, and the first one with a small risk is accepted. Two kinds of
terms have to be distinguished.

* **A posterior probability** is right at any time at which one stops. It is a conditional expectation of "the map is
  wrong", so that its mean over all accepted maps is the share of the wrong ones, whatever the rule of stopping
  (optional stopping). The same holds for a likelihood ratio: under the competing motion its mean is 1 at any time, so
  that it exceeds 1/p at any time with probability p at most (Ville's inequality).
* **The tail of a statistic** is no such probability. A statistic that is Gaussian at each look exceeds z at some look
  more often than at one. For a sum whose information grows by a factor G between the first look and the last,

      P(z is exceeded at any look) <= Q(z) (1 + max(z^2 - 1, 0) / 2 * ln G)

  up to terms of order 1/z^2 (Siegmund, "Sequential Analysis", 1985, chapter 4: the boundary of a constant significance
  level). :func:`at_any_time` is this bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from quest.noise import GATE_SIGMAS
from quest.robust.spatial_blocks import regions_of
from quest.tails import gaussian_tail
from slam_init.system.linear_algebra import deviations
from slam_init.types.arrays import Bools, Floats
from slam_init.types.correlated_errors import FIELD_PRIOR
from slam_init.types.lens import LensPrior
from slam_init.window.joint_fit import JointFit
from slam_init.window.levels import DOUBTFUL_SIGMAS, INFORMATION_GROWS, REGIONS, TURNING_FACTOR
from slam_init.window.linearization import (
    ErrorMarginal,
    Linearization,
    information_by_chance,
    linearize_with_fields,
    marginalize_fields,
)
from slam_init.window.motion import FittedMotion
from slam_init.window.state import WindowState

#: The stated distortion is suspected from here on: in the corner of a view of 70 degrees that moves a pixel by a
#: hundredth of its distance from the centre.
_LEAST_DISTORTION = 0.02
#: Tracks with less information about a focal length have none: a deviation by a factor of e to the 30.
_LEAST_INFORMATION = 1e-3


@dataclass(frozen=True, eq=False)
class ExpandedFit:
    """A fit, its quadratic expansion, and the posterior of the scale of its fields of correlated errors."""

    fit: JointFit
    linearization: Linearization
    marginal: ErrorMarginal

    @cached_property
    def scale_weights(self) -> Floats:
        """Posterior probability of each scale of the fields.

        Shapes: returns (S,).
        """
        log_weights = self.marginal.fields.log_evidence + np.log(FIELD_PRIOR)
        return np.asarray(np.exp(log_weights - np.logaddexp.reduce(log_weights)))

    @cached_property
    def directions(self) -> Floats:
        """Derivatives of the directions of the baselines of all views but the first, in radians.

        Shapes: returns (V - 1, 2, X).
        """
        return direction_derivatives(self.fit.state, len(self.marginal.shift))[1]

    @cached_property
    def scores(self) -> Floats:
        """How the unknowns follow the scores of each region of the image, for their scatter.

        Shapes: returns (12, X).

        * Returns: Its squares, summed over the regions, are the variances of the unknowns by the scatter.
        """
        used = np.flatnonzero(self.fit.tracks.anchor >= 0)
        region = regions_of(places_of(self.fit), REGIONS)[used]
        member = np.zeros((math.prod(REGIONS), len(used)))
        member[region, np.arange(len(used))] = 1.0
        sums = member @ self.linearization.shares[np.ix_(used, ~self.linearization.is_field)]
        # As many sums are used up as a direction has unknowns.
        count = int(member.any(axis=1).sum())
        return np.asarray(math.sqrt(count / max(count - 2, 1)) * (sums @ self.marginal.response.T))


class DirectionUncertainty(NamedTuple):
    """The uncertainty of the direction ``R^T t`` of a baseline."""

    #: (2, 3) Orthonormal vectors orthogonal to the direction, in the reference.
    basis: Floats
    #: (2, 2) Of the direction along these vectors, in rad^2.
    covariance: Floats


class InverseDistances(NamedTuple):
    """The inverse distances of the tracks from the reference, in units of the inverse of the pair's baseline."""

    #: (T,) Tracks that the reference and another view of the fit see. The figures of the other tracks have no
    #: meaning.
    known: Bools
    #: (T,) 0 for a track at infinity; negative for a track on the plane behind the camera.
    values: Floats
    #: (T,) Standard deviations.
    sigmas: Floats


class MovedByLens(NamedTuple):
    """How far a motion moves when the lens goes from where the fit has it to where a map has it."""

    #: (V - 1,) The rotations of all views but the first, from the reference.
    rotations_deg: Floats
    #: (V - 1,) Their directions.
    directions_deg: Floats


class FocalOfTracks(NamedTuple):
    """The information of the tracks of a fit about the focal length, without the prior."""

    #: Logarithm of the focal length over that of the prior, and its standard deviation.
    log_scale: float
    sigma: float


def expand(motion: FittedMotion) -> ExpandedFit:
    """Expand the cost of a fitted motion, and integrate the fields of correlated errors out."""
    expanded, by_chance = expand_for_evidence(motion), information_by_chance(motion.fit)
    return replace(expanded, marginal=expanded.marginal.without_chance(by_chance))


def expand_for_evidence(motion: FittedMotion) -> ExpandedFit:
    """The same where only the evidence is wanted: covariances count information by chance too."""
    linearization = linearize_with_fields(motion.fit)
    return ExpandedFit(motion.fit, linearization, marginalize_fields(linearization))


def lens_estimate(expanded: ExpandedFit, optimism: float = 1.0) -> LensPrior:
    """The lens of a fit, with correlated errors integrated out; no readout where it is no unknown of the fit.

    * ``optimism``: Factor on the standard deviation of the focal length, for what the covariance does not know.
    """
    linearization, marginal = expanded.linearization, expanded.marginal
    # The focal length stands before the distortion.
    J = np.eye(1, len(marginal.shift), linearization.k1_column - 1)
    sigma = max(_sigma_of(linearization.k1_column - 1, marginal), float(_scattered_sigmas(expanded, J)))
    readout = linearization.readout_column
    return LensPrior(
        focal_sigma=optimism * sigma,
        k1_sigma=_sigma_of(linearization.k1_column, marginal),
        readout_sigma_s=0.0 if readout is None else TURNING_FACTOR * _sigma_of(readout, marginal),
        mean=expanded.fit.state.lens,
    )


def focal_of_tracks(expanded: ExpandedFit) -> FocalOfTracks:
    """The focal length by the tracks alone, by the quadratic expansion of the fit."""
    marginal, priors = expanded.marginal, expanded.fit.priors
    J = np.eye(1, len(marginal.shift), expanded.linearization.k1_column - 1)
    shifts, covariances = marginal.of(J)
    variance = float(expanded.scale_weights @ covariances[:, 0, 0])
    off = expanded.fit.state.lens.log_scale + float(expanded.scale_weights @ shifts[:, 0]) - priors.mean.log_scale
    # The prior is one more measurement: without its information, the estimate is as much farther from its mean.
    information = max(1 / variance - 1 / priors.focal_sigma**2, _LEAST_INFORMATION)
    return FocalOfTracks(off / (variance * information), 1 / math.sqrt(information))


def significant_readout_s(lens: LensPrior) -> float:
    """The readout, 0 where it is not significant."""
    return lens.mean.readout_s if abs(lens.mean.readout_s) > GATE_SIGMAS * lens.readout_sigma_s else 0.0


def suspected_k1(lens: LensPrior) -> float | None:
    """What the stated distortion lacks, where it is suspected to be wrong, else None."""
    is_significant = abs(lens.mean.k1) > max(DOUBTFUL_SIGMAS * lens.k1_sigma, _LEAST_DISTORTION)
    return lens.mean.k1 if is_significant else None


def _sigma_of(column: int, marginal: ErrorMarginal) -> float:
    """Standard deviation of an unknown, over all scales of the fields of correlated errors."""
    J = np.eye(1, len(marginal.shift), column)
    log_weights = marginal.fields.log_evidence + np.log(FIELD_PRIOR)
    weights = np.exp(log_weights - log_weights.max())
    shifts, covariances = marginal.of(J)
    variance = float(weights @ (covariances[:, 0, 0] + shifts[:, 0] ** 2) / weights.sum())
    return math.sqrt(max(variance, 0.0))


def rotation_covariances(expanded: ExpandedFit) -> Floats:
    """Covariances of rotations: from the reference to each other view, then from the second view to each further one.

    Shapes: returns (2 V - 3, 3, 3).

    * Returns: Of vectors ``w``, in rad^2, where the true rotation is that of ``w`` after the fitted one.
    """
    R, unknowns = expanded.fit.state.R[1:], len(expanded.marginal.shift)
    of_view = 6 * np.arange(len(R))[:, None] + np.arange(3)
    from_reference = np.eye(unknowns)[of_view]
    from_second = from_reference[1:] - (R[1:] @ R[0].T) @ from_reference[0]
    return _second_moments(expanded, np.concatenate([from_reference, from_second]))


def rotation_sigmas_deg(expanded: ExpandedFit) -> Floats:
    """Largest standard deviations of the rotations of all views but the first, the pair's own first.

    A map holds both views of the pair. So the rotation of a further view is the less certain one of those from the
    reference and from the second view.

    Shapes: returns (V - 1,).
    """
    sigmas = deviations(np.linalg.eigvalsh(rotation_covariances(expanded)))[:, -1]
    views = len(expanded.fit.state.R) - 1
    return np.asarray(np.degrees(np.maximum(sigmas[:views], np.append(0.0, sigmas[views:]))))


def direction_uncertainty(expanded: ExpandedFit, view: int = 1) -> DirectionUncertainty:
    """Uncertainty of the direction of a baseline by the expansion alone, without the scatter of the scores."""
    bases, J = direction_derivatives(expanded.fit.state, len(expanded.marginal.shift))
    return DirectionUncertainty(bases[view - 1], _second_moments(expanded, J[view - 1]))


def direction_sigmas_deg(expanded: ExpandedFit) -> Floats:
    """Largest standard deviations of the directions: by the expansion or by the scatter of the scores.

    Shapes: returns (V - 1, S).
    """
    shifts, covariances = expanded.marginal.of(expanded.directions)
    covariances = covariances + shifts[..., :, None] * shifts[..., None, :]
    scattered = _scattered_sigmas(expanded, expanded.directions)[:, None]
    return np.asarray(np.degrees(np.maximum(deviations(np.linalg.eigvalsh(covariances))[..., -1], scattered)))


def sigma_with_known_lens(expanded: ExpandedFit) -> float:
    """How much of the deviation of the pair's direction is left if focal length and distortion were known."""
    J = expanded.directions[0]
    k1 = expanded.linearization.k1_column
    J = np.vstack([J, np.eye(2, J.shape[1], k1 - 1)])
    covariance = J @ expanded.marginal.covariance @ J.T
    by_lens = covariance[:2, 2:] @ np.linalg.solve(covariance[2:, 2:], covariance[2:, :2])
    largest = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
    left = float(np.linalg.eigvalsh(covariance[:2, :2] - by_lens)[-1])
    return math.sqrt(min(max(left / max(largest, 1e-300), 0.0), 1.0))


def direction_by_principal_point_deg(expanded: ExpandedFit) -> Floats:
    """Largest standard deviations of the directions by the error of the principal point alone.

    Shapes: returns (V - 1,).
    """
    columns = expanded.linearization.principal_columns
    if columns is None:
        return np.zeros(len(expanded.directions))
    covariance = expanded.marginal.covariance
    mixed = expanded.directions @ covariance[:, columns]
    by_point = mixed @ np.linalg.solve(covariance[columns, columns], np.swapaxes(mixed, 1, 2))
    return np.asarray(np.degrees(np.sqrt(np.maximum(np.linalg.eigvalsh(by_point)[:, -1], 0.0))))


def moved_by_lens(expanded: ExpandedFit, *, held: bool) -> MovedByLens:
    """How far the motion of a map, whose lens is the expected one, is from that of the fit, which moves the lens.

    All other unknowns follow the lens as their covariance says. A map never moves the principal point.

    * ``held``: Whether the map keeps focal length and distortion too.
    """
    lin, fit, covariance = expanded.linearization, expanded.fit, expanded.marginal.covariance
    state, lens, mean = fit.state, fit.state.lens, fit.priors.mean
    columns = [lin.k1_column - 1, lin.k1_column] if held else []
    offsets = [lens.log_scale - mean.log_scale, lens.k1 - mean.k1] if held else []
    if lin.principal_columns is not None:
        columns += [lin.principal_columns.start, lin.principal_columns.start + 1]
        offsets += lens.principal_px
    if not columns:
        return MovedByLens(np.zeros(len(state.R) - 1), np.zeros(len(state.R) - 1))
    moved = covariance[:, columns] @ np.linalg.solve(covariance[np.ix_(columns, columns)], np.array(offsets))
    directions_deg = np.degrees(np.linalg.norm(expanded.directions @ moved, axis=1))
    of_views = moved[: 6 * (len(state.R) - 1)].reshape(-1, 6)
    return MovedByLens(np.degrees(np.linalg.norm(of_views[:, :3], axis=1)), directions_deg)


def inverse_distances(expanded: ExpandedFit) -> InverseDistances:
    """The inverse distances of the tracks that the reference sees, with their standard deviations."""
    lin, state = expanded.linearization, expanded.fit.state
    values = state.inverse_distances.copy()
    if state.plane is not None:
        values[state.on_plane] = state.rays[state.on_plane] @ state.plane
    length = max(float(np.linalg.norm(state.t[1])), 1e-300)
    J = length * lin.distance_coupling[:, ~lin.is_field]
    J[:, 3:6] += values[:, None] * state.t[1] / length
    shared = expanded.marginal.variances(J, length * lin.distance_coupling[:, lin.is_field], expanded.scale_weights)
    variances = shared + length**2 * lin.distance_variance
    return InverseDistances(expanded.fit.tracks.anchor == 0, length * values, deviations(variances))


def places_of(fit: JointFit) -> Floats:
    """Where the tracks of a fit lie in their anchor views.

    Shapes: returns (T, 2).
    """
    rays = fit.state.rays
    return np.arctan2(rays[:, :2], rays[:, 2:])


def _second_moments(expanded: ExpandedFit, J: Floats) -> Floats:
    """Second moments (..., M, M) of linear functions (..., M, X) of the unknowns about the fit, over all scales."""
    shifts, covariances = expanded.marginal.of(J)
    moments = covariances + shifts[..., :, None] * shifts[..., None, :]
    return np.asarray(np.einsum("s,...sij->...ij", expanded.scale_weights, moments))


def direction_derivatives(state: WindowState, unknowns: int) -> tuple[Floats, Floats]:
    """Bases across the directions of the baselines of all views but the first, and their derivatives in radians.

    Shapes: returns (V - 1, 2, 3), returns (V - 1, 2, X).

    * ``unknowns``: The rotations and translations of the views come first among them.
    """
    t, world_from_view = state.t[1:], np.swapaxes(state.R[1:], 1, 2)
    lengths = np.maximum(np.linalg.norm(t, axis=1), 1e-300)[:, None, None]
    across = np.linalg.svd(np.swapaxes(world_from_view @ t[:, :, None], 1, 2) / lengths)[2][:, 1:]
    # Derivatives of R^T t by the rotation vector (from the left) and by t.
    by_turn = world_from_view @ np.cross(np.eye(3), t[:, None])
    own = across @ np.concatenate([by_turn, world_from_view], axis=2) / lengths
    J = np.zeros((len(t), 2, unknowns))
    for view, block in enumerate(own):
        J[view, :, 6 * view : 6 * view + 6] = block
    return np.asarray(across), J


def _scattered_sigmas(expanded: ExpandedFit, J: Floats) -> Floats:
    """Standard deviations (...,) of linear functions (..., M, X) by the scatter of the scores (a sandwich estimate).

    The larger one of the scatter over regions, which knows what neighbouring tracks share, and of that over tracks. The
    latter knows a noise that differs between tracks or between directions of the image.
    """
    lin, across = expanded.linearization, np.swapaxes(J, -1, -2)
    by_track = lin.shares[:, ~lin.is_field] @ (expanded.marginal.response.T @ across)
    scatters = (np.swapaxes(sums, -1, -2) @ sums for sums in (expanded.scores @ across, by_track))
    by_regions, by_tracks = (np.linalg.eigvalsh(one)[..., -1] for one in scatters)
    return np.asarray(np.sqrt(np.maximum(np.maximum(by_regions, by_tracks), 0.0)))


# -- tails of errors in two and in three directions, and of a statistic that is tested often ---------------------------


def two_directions(limit: float, sigmas: Floats) -> Floats:
    """Probability that an error in two directions exceeds a limit, by its largest standard deviation.

    Shapes: ``sigmas`` (S,), returns (S,).
    """
    return np.asarray(np.exp(-0.5 * (limit / np.maximum(sigmas, 1e-9)) ** 2))


def three_directions(limit: float, sigma: float) -> float:
    """The same in three directions: the tail of chi-square with three degrees of freedom."""
    z = limit / max(sigma, 1e-9)
    return math.erfc(z / math.sqrt(2)) + math.sqrt(2 / math.pi) * z * math.exp(-0.5 * z * z)


def chi_square_as_gaussian(mean_square: Floats, freedom: float) -> Floats:
    """Chi-square as standard deviations of a Gaussian: its cube root is nearly Gaussian (Wilson and Hilferty, 1931).

    Shapes: ``mean_square`` (N,) chi-square over its degrees of freedom, returns (N,).
    """
    spread = 2 / (9 * freedom)
    return np.asarray((mean_square ** (1 / 3) - (1 - spread)) / math.sqrt(spread))


def at_any_time(z: float) -> float:
    """Probability that a statistic exceeds z at any look, where a window is evaluated again while frames arrive."""
    return min(1.0, gaussian_tail(z) * (1 + 0.5 * max(z * z - 1, 0.0) * math.log(INFORMATION_GROWS)))
