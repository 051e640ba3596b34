"""The noise of the tracks, estimated from the residuals of bundle adjustment, and the parallax that a landmark needs.

The covariances of the map are computed with the estimated noise, not with the configured one.
"""

from __future__ import annotations

import math

import numpy as np

from slam_init.bundle.problem import BundleProblem
from slam_init.config import MapConfig
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

#: Median of the squared length of a 2-D Gaussian, in variances.
MEDIAN_SQUARE = 2 * math.log(2)


def estimate_noise(problem: BundleProblem, residuals: Floats, config: MapConfig) -> float:
    """Estimate the noise from the median of the residuals, corrected for the number of fitted unknowns.

    Shapes: ``residuals`` (M, 2).

    * Returns: Standard deviation of one coordinate of one observation in pixels, at least ``config.min_noise_px``.
    """
    norms = np.linalg.norm(residuals, axis=1)
    norms = norms[np.isfinite(norms)]
    if len(norms) == 0:
        return config.noise_px
    raw = float(np.median(norms) / np.sqrt(MEDIAN_SQUARE))
    return max(raw * float(np.sqrt(2 * len(norms) / _freedom(problem, len(norms)))), config.min_noise_px)


def least_squares_noise(problem: BundleProblem, residuals: Floats, config: MapConfig) -> float:
    """Estimate the noise from the mean square of residuals without outliers.

    Without outliers this is better than :func:`estimate_noise`, whose median is too low for few degrees of freedom.

    Shapes: ``residuals`` (M, 2).

    * Returns: Standard deviation of one coordinate of one observation in pixels, at least ``config.min_noise_px``.
    """
    squares = float(np.sum(residuals**2))
    return max(float(np.sqrt(squares / _freedom(problem, len(residuals)))), config.min_noise_px)


def _freedom(problem: BundleProblem, observations: int) -> float:
    """Number of observed coordinates less fitted unknowns, at least a twentieth of the observations.

    An adjusted focal length does not change it: it adds one unknown, and its prior adds one measurement.
    """
    unknowns = 3 * len(problem.points) + 6 * (len(problem.frames) - 1) - 1
    return max(2.0 * observations - unknowns, 0.05 * observations)


def min_parallax_rad(camera: Camera, noise_px: float, config: MapConfig) -> float:
    """Compute the least parallax at which the depth of a landmark is as precise as the configuration requires.

    Two rays with noise s each that meet at the angle a give a depth with relative standard deviation sqrt(2) s / a.

    * ``config``: ``max_depth_sigma`` is the largest relative standard deviation of a depth.
    """
    return float(np.sqrt(2) * noise_px / camera.focal_px / config.max_depth_sigma)
