"""The fields of correlated errors of a fit, integrated out.

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

from slam_init.types.arrays import Floats
from slam_init.types.correlated_errors import FIELD_SCALES_PX, LARGEST_PULL_SIGMAS, CorrelatedErrors
from slam_init.window.linearization import Linearization

#: The largest share of the information about an unknown that is taken for chance: deviations are twenty times as wide
#: then, and a share so near to one is itself known within a twentieth at best (tracks are a few hundred).
#: Class: level.
_LARGEST_SHARE_BY_CHANCE = 0.95
#: Of a sum of unknowns in units of their standard deviations: rounding leaves no more, and may leave less than nothing.
_LEAST_VARIANCE = 1e-14


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
    def log_evidence(self) -> Floats:
        """(S,) logarithm of the probability of the tracks with fields of each scale, over that without fields."""
        return self.fields.log_evidence

    @property
    def lowered_cost(self) -> Floats:
        """(S,) how much the fields lower the cost."""
        return np.asarray(self.fields.spread @ self.fields.pull**2)

    @staticmethod
    def expected_scale_px(weights: Floats) -> float:
        """Expected scale of the fields.

        Shapes: ``weights`` (S,).
        """
        return float(weights @ FIELD_SCALES_PX)

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
