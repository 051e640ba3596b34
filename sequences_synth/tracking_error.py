"""Correlated tracking error: a smooth field of pixel errors that all tracks of one view have in common.

The field of a view is a polynomial of the image coordinates with constant, linear and quadratic terms, one polynomial
per pixel coordinate. The polynomials of :func:`_basis` are orthonormal over the image. The mean square of the field
over the image is therefore the sum of its squared coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats

# Number of polynomials of degree 2 or less in two variables.
_TERMS = 6


@dataclass(frozen=True, eq=False)
class TrackingError:
    """The smooth correlated error of each view.

    Attributes
    ----------
    width, height : int
        Image size in pixels.
    coefficients_px : (V, 2, 6) float
        Coefficients by view, pixel coordinate (x, y) and polynomial. The polynomials are orthonormal over the image, in
        the order 1, x, y, x^2, x y, y^2 of their leading terms.
    """

    width: int
    height: int
    coefficients_px: Floats

    @staticmethod
    def draw(
        rng: np.random.Generator, views: int, width: int, height: int, field_px: float, drift_px: float
    ) -> TrackingError:
        """Draw the sum of a field that is independent in each view and of a field that drifts from view to view.

        Parameters
        ----------
        rng : numpy.random.Generator
            The number of draws depends on ``views`` only.
        views : int
            At least 2.
        width, height : int
            Image size in pixels.
        field_px : float
            Root mean square of one coordinate over the image, for the independent field of each view.
        drift_px : float
            The same for the drift in the last view. The drift is zero in the first view, and its coefficients perform a
            random walk.

        Returns
        -------
        TrackingError
        """
        field = rng.normal(size=(views, 2, _TERMS))
        field *= field_px / _rms(field)
        walk = np.zeros((views, 2, _TERMS))
        walk[1:] = np.cumsum(rng.normal(size=(views - 1, 2, _TERMS)), axis=0)
        walk *= drift_px / _rms(walk[-1])
        return TrackingError(width, height, field + walk)

    def at(self, index: int, pixels: Floats) -> Floats:
        """Compute the correlated tracking error of one view.

        Parameters
        ----------
        index : int
            Position of the view, from 0.
        pixels : (N, 2) float
            True pixels.

        Returns
        -------
        (N, 2) float
            Measured minus true pixels.
        """
        centre = 0.5 * (np.array([self.width, self.height]) - 1)
        return np.asarray(_basis((pixels - centre) / centre) @ self.coefficients_px[index].T)


def _basis(where: Floats) -> Floats:
    """(N, 6) products of Legendre polynomials; ``where`` (N, 2) runs from -1 to 1 over the image.

    Any two of them have a mean product of 0 over the image, and each has a mean square of 1.
    """
    x, y = where.T
    linear_x, linear_y = np.sqrt(3) * x, np.sqrt(3) * y
    quadratic_x, quadratic_y = np.sqrt(5) / 2 * (3 * x**2 - 1), np.sqrt(5) / 2 * (3 * y**2 - 1)
    return np.column_stack([np.ones(len(where)), linear_x, linear_y, quadratic_x, linear_x * linear_y, quadratic_y])


def _rms(coefficients: Floats) -> Floats:
    """Root mean square (..., 1, 1) of one coordinate over the image, of fields with the coefficients (..., 2, 6)."""
    return np.asarray(np.sqrt(np.sum(coefficients**2, axis=(-2, -1), keepdims=True) / 2))
