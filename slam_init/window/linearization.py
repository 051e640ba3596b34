"""The quadratic expansion of the cost of a joint fit, with fields of correlated errors in all views.

The tracks of a view share errors: of the lens model, of the shutter, of the tracker. A smooth field for each view
describes them (:mod:`slam_init.window.kernel`). How large the fields are is not known beforehand, and the tracks show
it: errors that neighbours share do not average out. So the scale of the fields has a posterior too. It decides how far
a competing motion is behind (its fields explain a part of its residuals), and how certain the direction of the baseline
is.

With the quadratic expansion of the cost (Laplace), both have a closed form for each scale: one eigenvalue
decomposition serves all scales.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.algebra import tangents
from slam_init.types.arrays import Bools, Floats
from slam_init.types.correlated_errors import LARGEST_PULL_SIGMAS, CorrelatedErrors
from slam_init.window.equations import WindowEquations
from slam_init.window.joint_fit import JointFit
from slam_init.window.kernel import TUKEY_GATES

#: A gate that weights all observations alike.
_NO_GATE = 1e6
#: The largest share of the information about an unknown that is taken for chance: deviations are twenty times as wide
#: then, and a share so near to one is itself known within a twentieth at best (tracks are a few hundred).
#: Class: level.
_LARGEST_SHARE_BY_CHANCE = 0.95
#: Of a sum of unknowns in units of their standard deviations: rounding leaves no more, and may leave less than nothing.
_LEAST_VARIANCE = 1e-14


@dataclass(frozen=True, eq=False)
class Linearization:
    """The quadratic expansion of the cost about a fit, with fields of correlated errors that have no prior yet."""

    #: information, gradient: (G, G), (G,) Half of the second and half of the first derivatives of the cost, tracks
    #: eliminated, baseline held.
    information: Floats
    gradient: Floats
    #: (T, G) The share of each track in the gradient.
    shares: Floats
    #: (G,) Which unknowns are coefficients of the fields. The others have the order of :attr:`JointFit.information`.
    is_field: Bools
    #: (T,) Variance of the inverse distance of each track, if the unknowns that the tracks share were known.
    distance_variance: Floats
    #: (T, G) How the inverse distance of each track follows the other unknowns.
    distance_coupling: Floats
    #: The radial distortion among the unknowns that are not coefficients of fields.
    k1_column: int
    #: The readout among them; None where it is known.
    readout_column: int | None
    #: The principal point among them; None where it is known.
    principal_columns: slice | None = None


def linearize_with_fields(fit: JointFit) -> Linearization:
    """Expand the cost of a fit in all its unknowns and in the fields of correlated errors of the views.

    The distances of tracks at infinity count as unknowns too: that a distance is not negative bounds it on one side
    only. Their gradient, which the bound stops, is left out.
    """
    state, priors = fit.state, fit.priors
    equations = WindowEquations(fit.tracks, state, replace(priors, field_sigma_px=np.inf), fit.rotation_only)
    equations.held_view = fit.held_view
    equations.build(state, hold=False)
    gradients, covariances = equations.track_gradients, equations.track_covariances
    # At infinity, these tracks are held by a distance that would become negative.
    held = ~state.on_plane & (state.inverse_distances == 0) & (gradients[:, 2] > 0)
    shares = equations.shares
    # The equations are linear in the gradients of the tracks.
    along_distance = equations.coupling_along(covariances[:, 2])
    shares[held] += along_distance[held] * gradients[held, 2:]
    gradient = shares.sum(axis=0) + equations.prior_gradient(state)
    variance = covariances[:, 2, 2].copy()
    coupling = -along_distance
    if state.plane is not None:
        # In the reference, the inverse distance along a ray is the product of the plane and the ray. The ray follows
        # the other unknowns too, most of all the focal length.
        on_plane = np.flatnonzero(state.on_plane & (fit.tracks.anchor == 0))
        bases = np.array([tangents(ray) for ray in state.rays[on_plane]]).reshape(-1, 2, 3)
        by_ray = np.stack([np.ascontiguousarray(bases[:, q]) @ state.plane for q in range(2)], axis=1)
        follow = np.zeros((len(state.rays), 3))
        follow[on_plane, :2] = np.einsum("tp,tpq->tq", by_ray, covariances[on_plane, :2, :2])
        variance[on_plane] = np.einsum("tq,tq->t", by_ray, follow[on_plane, :2])
        coupling[on_plane] = -equations.coupling_along(follow)[on_plane]
        coupling[on_plane, -3:] += state.rays[on_plane]
    information = equations.information(state)
    is_field = equations.columns_of_fields()
    k1 = int((~is_field)[: equations.focal + 1].sum())
    readout = k1 + 1 if priors.readout_sigma_s > 0 else None
    after = k1 + 1 if readout is None else readout + 1
    principal = slice(after, after + 2) if priors.principal_sigma_px > 0 else None
    return Linearization(information, gradient, shares, is_field, variance, coupling, k1, readout, principal)


def information_by_chance(fit: JointFit) -> Floats:
    """The part of a fit's information that the errors of the inverse distances make.

    A track measures the direction of a baseline by its parallax ``rho t``, and its information grows with the square of
    the inverse distance ``rho``. The fit has ``rho`` with an error of variance ``s^2``, and the expectation of its
    square is larger than the true square by ``s^2``. Where the parallax of most tracks is no larger than their errors,
    most of the information is of this kind: a track then measures a direction, but one that depends on its error. The
    part is the mean of the information at ``rho + s`` and ``rho - s``, less that at ``rho``.

    Shapes: returns (X, X).

    * Returns: In the order of :attr:`JointFit.information`, tracks eliminated.
    """
    state, tracks, priors = fit.state, fit.tracks, fit.priors
    # An error of a distance must not change the weight of an observation: each has the weight of the fit, as its noise.
    squares = np.einsum("vtq,vtq->vt", fit.residuals, fit.residuals)
    left = np.maximum(1 - squares / (TUKEY_GATES * priors.gate_sigmas**2), 0.0)
    # A single observation measures no distance, so that the error of this distance has no size.
    seen = tracks.seen & (left > 0)
    seen &= seen.sum(axis=0) >= 2
    weighted = replace(tracks, seen=seen, sigma_px=tracks.sigma_px / np.maximum(left, 1e-6))
    equations = WindowEquations(weighted, state, replace(priors, gate_sigmas=_NO_GATE))
    equations.build(state, hold=False)
    own = equations.normal.copy()
    # A distance that is held at infinity has no error that makes information.
    sigmas = np.sqrt(np.maximum(equations.track_covariances[:, 2, 2], 0.0)) * (state.inverse_distances > 0)
    by_chance = -own
    for sign in (1, -1):
        moved = replace(state, inverse_distances=state.inverse_distances + sign * sigmas)
        equations.build(moved, hold=False)
        by_chance += 0.5 * equations.normal
    return by_chance


# -- fields of correlated errors, integrated out -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ErrorMarginal:
    """What a fit says for each scale of its fields."""

    fields: CorrelatedErrors
    #: (X, X) Of the other unknowns without fields.
    covariance: Floats
    #: (X, X) How the other unknowns follow a gradient, without fields: the covariance, unless :meth:`without_chance`
    #: changed both.
    response: Floats
    #: (X,) Of the other unknowns without fields; 0 up to the tolerance of the fit.
    shift: Floats
    #: (X, F) How the other unknowns follow the fields along the eigenvectors.
    coupling: Floats

    @property
    def lowered_cost(self) -> Floats:
        """(S,) how much the fields lower the cost."""
        return np.asarray(self.fields.spread @ self.fields.pull**2)

    def of(self, J: Floats) -> tuple[Floats, Floats]:
        """Posterior of linear functions of the unknowns, for each scale.

        Shapes: ``J`` (..., M, X), returns ``shifts`` (..., S, M), returns ``covariances`` (..., S, M, M).
        """
        follow, fixed = J @ self.coupling, J @ self.covariance @ np.swapaxes(J, -1, -2)
        across = np.swapaxes(follow, -1, -2)
        shifts = (J @ self.shift)[..., None, :] + (self.fields.spread * self.fields.pull) @ across
        by_fields = (follow[..., None, :, :] * self.fields.spread[:, None]) @ across[..., None, :, :]
        return np.asarray(shifts), np.asarray(fixed[..., None, :, :] + by_fields)

    def without_chance(self, by_chance: Floats) -> ErrorMarginal:
        """The marginal if a part of the information is none.

        The unknowns follow a gradient by the inverse of the information that is left. The scatter of the gradient is
        that of all the information: the errors of the tracks that make the part are in it.

        Shapes: ``by_chance`` (X, X).

        * ``by_chance``: The part, of :func:`slam_init.window.linearization.information_by_chance`.
        """
        if not (np.diag(self.covariance) > 0).all():
            raise np.linalg.LinAlgError("a covariance is not positive definite")
        # In units of the standard deviations: those of a view that is hardly seen are larger by many orders.
        units = np.sqrt(np.diag(self.covariance))
        correlation = 0.5 * (self.covariance + self.covariance.T) / np.outer(units, units)
        variances, vectors = np.linalg.eigh(correlation)
        sigmas = np.sqrt(np.maximum(variances, _LEAST_VARIANCE))
        root = units[:, None] * vectors * sigmas
        shares, axes = np.linalg.eigh(root.T @ (0.5 * (by_chance + by_chance.T)) @ root)
        wider = root @ (axes / (1 - np.clip(shares, 0.0, _LARGEST_SHARE_BY_CHANCE)))
        follow = np.asarray(wider @ axes.T @ (vectors / sigmas).T / units)
        return replace(
            self,
            covariance=np.asarray(wider @ wider.T),
            response=np.asarray(wider @ (root @ axes).T),
            shift=follow @ self.shift,
            coupling=follow @ self.coupling,
        )

    def variances(self, J: Floats, J_fields: Floats, weights: Floats) -> Floats:
        """Second moments about the fit of linear functions of the unknowns and of the fields, over all scales.

        Shapes: ``J`` (M, X), ``J_fields`` (M, F), ``weights`` (S,), returns (M,).

        * ``J_fields``: Derivatives of the functions by the coefficients of the fields.
        """
        # The sign is that of the coupling: a function falls along an eigenvector by this.
        follow = J @ self.coupling - J_fields @ self.fields.axes
        shifts = J @ self.shift + (self.fields.spread * self.fields.pull) @ follow.T
        without = np.einsum("mx,xy,my->m", J, self.covariance, J, optimize=True)
        return np.asarray(without + follow**2 @ (weights @ self.fields.spread) + weights @ shifts**2)


def marginalize_fields(
    linearization: Linearization, *, largest_pull_sigmas: float = LARGEST_PULL_SIGMAS
) -> ErrorMarginal:
    """Integrate the fields of correlated errors out.

    * ``largest_pull_sigmas``: A larger pull of the fields counts as this number of its standard deviations; infinity
      for exact integrals.
    """
    field, other = linearization.is_field, ~linearization.is_field
    H, g = linearization.information, linearization.gradient
    covariance = np.asarray(np.linalg.inv(H[np.ix_(other, other)] + 1e-9 * np.eye(int(other.sum()))), np.float64)
    follow = covariance @ H[np.ix_(other, field)]
    left = H[np.ix_(field, field)] - H[np.ix_(field, other)] @ follow
    fields = CorrelatedErrors.of(left, g[field] - follow.T @ g[other], largest_pull_sigmas)
    shift = np.asarray(-covariance @ g[other], np.float64)
    return ErrorMarginal(fields, covariance, covariance, shift, np.asarray(follow @ fields.axes))
