"""The pinhole camera of the synthetic worlds, with one coefficient of radial distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sequences_synth.lens_camera import LensCamera

Floats = NDArray[np.float64]

# Newton's method for the radius of an undistorted pixel. For coefficients within the range of the options, 8 steps
# reach a residual below 1e-12; the others are a margin.
_NEWTON_STEPS = 20


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera; all values in pixels, pixel centres at integer coordinates."""

    #: width, height: Image size.
    width: int
    height: int
    #: fx, fy, cx, cy: Focal lengths and principal point.
    fx: float
    fy: float
    cx: float
    cy: float
    #: Radial distortion: a ray (x, y, 1) is seen where an ideal camera would see (x d, y d, 1), with ``d = 1 + k1
    #: (x^2 + y^2)``. The stated cameras have none.
    k1: float = 0.0

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def largest_radius(self) -> float:
        """Tangent of the angle to the optical axis up to which the distortion is invertible; infinite for most lenses.

        With a negative ``k1`` the distorted radius has a maximum. Rays beyond it are not seen.
        """
        return math.sqrt(-1 / (3 * self.k1)) if self.k1 < 0 else math.inf

    def project(self, points: Floats) -> Floats:
        """Project points before the camera.

        Shapes: ``points`` (..., 3), returns (..., 2).
        """
        focal, centre = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        z = points[..., 2:]
        if self.k1 == 0.0:
            return np.asarray(focal * points[..., :2] / z + centre)
        ideal = points[..., :2] / z
        return np.asarray(focal * ideal * (1 + self.k1 * np.sum(ideal**2, axis=-1, keepdims=True)) + centre)

    def rays(self, pixels: Floats) -> Floats:
        """Compute the rays of pixels.

        Shapes: ``pixels`` (..., 2), returns (..., 3).

        * Returns: In the frame of the camera, with z = 1. A pixel beyond the largest distorted radius has the ray of
          this radius.
        """
        seen = (pixels - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        if self.k1 != 0.0:
            seen = seen * self._undistortion(np.linalg.norm(seen, axis=-1, keepdims=True))
        return np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1)

    def _undistortion(self, distorted: Floats) -> Floats:
        """Radius without distortion over that with it."""
        limit = self.largest_radius
        if math.isfinite(limit):
            distorted = np.minimum(distorted, limit * (1 + self.k1 * limit**2))
        # The distorted radius is concave up to the limit for k1 < 0, and convex for k1 > 0. From these starts Newton's
        # steps do not overshoot into the other branch.
        radius = distorted.copy()
        for _ in range(_NEWTON_STEPS):
            slope = 1 + 3 * self.k1 * radius**2
            step = (radius * (1 + self.k1 * radius**2) - distorted) / np.where(np.abs(slope) > 1e-9, slope, 1.0)
            radius = np.clip(radius - step, 0.0, limit)
        return np.asarray(np.where(distorted > 0, radius / np.where(distorted > 0, distorted, 1.0), 1.0))


#: Either camera.
AnyCamera = TypeVar("AnyCamera", bound=PinholeCamera | LensCamera)


def stated_camera(true: AnyCamera, focal_error: float, principal_error: float, rng: np.random.Generator) -> AnyCamera:
    """Make the camera that the data state, which lacks the distortion of a pinhole and may have wrong values.

    * ``focal_error``: The stated focal length is the true one times ``1 + focal_error``.
    * ``principal_error``: Horizontal error of the principal point over the width, and vertical error over the height.
    """
    right, down = rng.choice([-1.0, 1.0], 2).tolist()
    ideal: AnyCamera = replace(true, k1=0.0) if isinstance(true, PinholeCamera) else true
    return replace(
        ideal,
        fx=true.fx * (1 + focal_error),
        fy=true.fy * (1 + focal_error),
        cx=true.cx + right * principal_error * true.width,
        cy=true.cy + down * principal_error * true.height,
    )
