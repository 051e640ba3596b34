"""Smooth fields of correlated errors of the tracks of a view: errors of lens model, shutter and tracker.

A field moves both coordinates of the pixels of a view by six polynomials each. How large the twelve coefficients are is
not known beforehand, and the tracks show it: errors that neighbours share do not average out. So the scale of the
fields has a posterior. With a quadratic expansion of the cost it has a closed form for each scale: one decomposition
into eigenvectors serves all scales.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

#: Standard deviation of a coefficient of a field, in pixels: from none to a lens without its distortion, in steps of a
#: factor of two. The root mean square of a coordinate over the image is 2.4 times as large.
#: Class: assumption.
FIELD_SCALES_PX: Floats = np.array([0.0, 0.03, 0.06, 0.125, 0.25, 0.5, 1.0, 2.0])
#: Probability of each scale before the tracks are seen: rectified lenses and good trackers leave a tenth of a pixel;
#: more than half a pixel is a camera model that does not hold.
#: Class: assumption.
FIELD_PRIOR: Floats = np.array([0.2, 0.2, 0.2, 0.2, 0.12, 0.05, 0.02, 0.01])
#: Fields of the largest scale pull by chance farther than this number of their standard deviations six times in
#: ten million. Tracks that are held at infinity pull although they have no information about a field.
#: Class: level.
LARGEST_PULL_SIGMAS = 5.0


class CorrelatedErrors(NamedTuple):
    """The fields by a quadratic expansion, along the eigenvectors of the information about them."""

    #: (F,) Eigenvalues of the information.
    strength: Floats
    #: (F,) The gradient along the eigenvectors, at most what fields of the largest scale explain.
    pull: Floats
    #: (F, F) The eigenvectors, as columns.
    axes: Floats
    #: (S, F) Variances of the coefficients for each scale, given the tracks.
    spread: Floats
    #: (S,) Logarithm of the probability of the tracks with fields of each scale, over that without fields.
    log_evidence: Floats

    @staticmethod
    def of(information: Floats, gradient: Floats, largest_pull_sigmas: float = LARGEST_PULL_SIGMAS) -> CorrelatedErrors:
        """The fields by the information (F, F) that other unknowns leave, and the gradient (F,).

        * ``largest_pull_sigmas``: A larger pull of the fields counts as this number of its standard deviations;
          infinity for exact integrals.
        """
        eigenvalues, axes = np.linalg.eigh(0.5 * (information + information.T))
        strength, squares = np.maximum(eigenvalues, 0.0), FIELD_SCALES_PX[:, None] ** 2
        largest = largest_pull_sigmas * np.sqrt(strength * (1 + FIELD_SCALES_PX.max() ** 2 * strength))
        pull = np.clip(axes.T @ gradient, -largest, largest)
        spread = squares / (1 + squares * strength)
        log_evidence = 0.5 * (spread @ pull**2 - np.log1p(squares * strength).sum(axis=1))
        return CorrelatedErrors(strength, pull, axes, spread, log_evidence)

    @property
    def mean_square(self) -> float:
        """Expected square of a coefficient in square pixels, given that there are fields."""
        logs = (np.log(FIELD_PRIOR) + self.log_evidence)[1:]
        weights = np.exp(logs - logs.max())
        return float(weights @ FIELD_SCALES_PX[1:] ** 2 / weights.sum())


def orthonormal_polynomials(camera: Camera, pixels: Floats) -> Floats:
    """Products (..., 6) of Legendre polynomials at pixels (..., 2).

    Each has a mean square of 1 over the image, so that none is preferred.
    """
    x, y = np.moveaxis(2 * pixels / (camera.width - 1, camera.height - 1) - 1, -1, 0)
    linear_x, linear_y = np.sqrt(3) * x, np.sqrt(3) * y
    quadratic_x, quadratic_y = (np.sqrt(5) / 2 * (3 * u * u - 1) for u in (x, y))
    return np.stack([np.ones_like(x), linear_x, linear_y, quadratic_x, linear_x * linear_y, quadratic_y], axis=-1)
