"""The noise of the tracks as bundle adjustment sees it, and the parallax that it asks of a landmark.

The noise is estimated from the residuals, so that the covariances mean what they say.
"""

from __future__ import annotations

import numpy as np

from slam_init.bundle.problem import BundleProblem
from slam_init.config import MapConfig
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

__all__ = ["estimate_noise", "least_squares_noise", "min_parallax_rad"]


def estimate_noise(problem: BundleProblem, residuals: Floats, config: MapConfig) -> float:
    """Standard deviation of one coordinate of one observation, robust, corrected for the fitted unknowns."""
    norms = np.linalg.norm(residuals, axis=1)
    norms = norms[np.isfinite(norms)]
    if len(norms) == 0:
        return config.noise_px
    # The median of the norm of a 2-D Gaussian is sqrt(2 ln 2) standard deviations.
    raw = float(np.median(norms) / np.sqrt(2 * np.log(2)))
    return max(raw * float(np.sqrt(2 * len(norms) / _freedom(problem, len(norms)))), config.min_noise_px)


def least_squares_noise(problem: BundleProblem, residuals: Floats, config: MapConfig) -> float:
    """The same without outliers, where the mean square is better: of few degrees of freedom the median is too low."""
    squares = float(np.sum(residuals**2))
    return max(float(np.sqrt(squares / _freedom(problem, len(residuals)))), config.min_noise_px)


def _freedom(problem: BundleProblem, observations: int) -> float:
    """Coordinates observed less unknowns fitted; a twentieth of the observations at the least.

    An adjusted focal length is one unknown more, and its prior one datum more.
    """
    unknowns = 3 * len(problem.points) + 6 * (len(problem.frames) - 1) - 1
    return max(2.0 * observations - unknowns, 0.05 * observations)


def min_parallax_rad(camera: Camera, noise_px: float, config: MapConfig) -> float:
    """Parallax below which the relative depth of a landmark is less certain than the configuration allows.

    Two rays with noise s each meet under the angle a at a depth with relative standard deviation sqrt(2) s / a.
    """
    return float(np.sqrt(2) * noise_px / camera.focal_px / config.max_depth_sigma)
