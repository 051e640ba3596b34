"""Smooth functions of the place in an image."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera


def orthonormal_polynomials(camera: Camera, pixels: Floats) -> Floats:
    """Products (..., 6) of Legendre polynomials at pixels (..., 2).

    Each has a mean square of 1 over the image, so that none is preferred.
    """
    x, y = np.moveaxis(2 * pixels / (camera.width - 1, camera.height - 1) - 1, -1, 0)
    linear_x, linear_y = np.sqrt(3) * x, np.sqrt(3) * y
    quadratic_x, quadratic_y = (np.sqrt(5) / 2 * (3 * u * u - 1) for u in (x, y))
    return np.stack([np.ones_like(x), linear_x, linear_y, quadratic_x, linear_x * linear_y, quadratic_y], axis=-1)
