"""The lens models on the plane z = 1: OpenCV's radial-tangential model and its equidistant (fisheye) model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from slam_init.types.arrays import Bools, Floats
from slam_init.types.lenses.lens import Bending

# Newton's method doubles the number of correct digits in each step. Real lenses need 4 to 8 steps; pixels near the
# radius at which the lens polynomial stops growing need more.
_NEWTON_STEPS = 30
# Largest residual on the plane z = 1 of an undistorted pixel: 1e-7 px for a focal length of 1000 px.
_SOLVED = 1e-10
#: Rays are represented on the plane z = 1, which ends at 90 degrees.
MAX_PLANAR_ANGLE_RAD = math.radians(89.0)


def polynomial(k: tuple[float, ...], r: Floats) -> tuple[Floats, Floats]:
    """Compute the value and the derivative of ``r (1 + k1 r^2 + k2 r^4 + ...)``.

    Shapes: ``r`` (N,), returns ``value, slope`` (N,).
    """
    value, slope = np.ones_like(r), np.ones_like(r)
    for i, ki in enumerate(k, start=1):
        power = r ** (2 * i)
        value = value + ki * power
        slope = slope + (2 * i + 1) * ki * power
    return r * value, slope


@lru_cache(maxsize=1024)
def turning_radius(k: tuple[float, ...], limit: float) -> float:
    """Find the radius at which ``r (1 + k1 r^2 + ...)`` stops growing."""
    # The slope is a polynomial in s = r^2. At its smallest positive root the distorted radius stops growing.
    # A coefficient below 1e-100 moves nothing, and a division by it overflows.
    coefficients = [(2 * i + 1) * ki if abs(ki) > 1e-100 else 0.0 for i, ki in enumerate(k, start=1)]
    roots = np.roots([*reversed(coefficients), 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return min(limit, float(np.sqrt(real.min()))) if len(real) else limit


@dataclass(frozen=True)
class RadialTangentialLens:
    """OpenCV's ``k1 k2 p1 p2 [k3]``; without coefficients the lens of a pinhole camera."""

    coefficients: tuple[float, ...]

    @property
    def max_tangent(self) -> float:
        """Radius on the plane at which the distorted radius stops growing."""
        return turning_radius((*self.coefficients[:2], *self.coefficients[4:]), np.inf)

    def sees(self, xy: Floats) -> Bools:
        """Tell which points of the plane are within the field: ``xy`` (N, 2), returns (N,).

        The field of a lens without distortion has no border, so that an infinite point keeps its infinite pixel.
        """
        if not any(self.coefficients):
            return np.ones(len(xy), bool)
        return np.asarray(np.hypot(xy[:, 0], xy[:, 1]) < self.max_tangent)

    def distort(self, xy: Floats) -> Floats:
        """Distort points of the plane: ``xy`` (N, 2), returns (N, 2)."""
        k1, k2, p1, p2, k3 = (*self.coefficients, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        return Bending(k1, k2, k3, p1=p1, p2=p2).apply(xy)

    def undistort(self, distorted: Floats) -> Floats:
        """Invert :meth:`distort`: ``distorted`` (N, 2), returns (N, 2) with NaN where there is no ray.

        Newton's method starts from the distorted point. For the radial part alone it converges monotonically, for
        barrel and for pincushion lenses (the profile is concave or convex). The tangential part is small.
        """
        if not any(self.coefficients):
            return distorted
        from slam_init.types.lenses.planar_kernel import undistorted

        coefficients = np.zeros(5)
        coefficients[: len(self.coefficients)] = self.coefficients
        xy = undistorted(np.require(distorted, np.float64, ["C", "W"]), coefficients, _SOLVED)
        # A root beyond the turning radius is another ray, which the lens polynomial maps to the same pixel.
        with np.errstate(all="ignore"):  # points without a ray are NaN
            return np.where(self.sees(xy)[:, None], xy, np.nan)


@dataclass(frozen=True)
class FisheyeLens:
    """OpenCV's ``k1 k2 k3 k4``: the distorted radius is a polynomial of the angle."""

    coefficients: tuple[float, ...]

    @property
    def _limit_rad(self) -> float:
        return turning_radius(self.coefficients, MAX_PLANAR_ANGLE_RAD)

    @property
    def max_tangent(self) -> float:
        """Tangent of the angle at which the distorted radius stops growing, or of 89 degrees."""
        return math.tan(self._limit_rad)

    def sees(self, xy: Floats) -> Bools:
        """Tell which points of the plane are within the field: ``xy`` (N, 2), returns (N,)."""
        return np.asarray(np.arctan(np.hypot(xy[:, 0], xy[:, 1])) < self._limit_rad)

    def distort(self, xy: Floats) -> Floats:
        """Distort points of the plane: ``xy`` (N, 2), returns (N, 2)."""
        radius = np.hypot(xy[:, 0], xy[:, 1])
        distorted, _ = polynomial(self.coefficients, np.arctan(radius))
        return np.asarray(xy * np.where(radius > 1e-12, distorted / np.maximum(radius, 1e-12), 1.0)[:, None])

    def undistort(self, distorted: Floats) -> Floats:
        """Invert :meth:`distort`: ``distorted`` (N, 2), returns (N, 2) with NaN where there is no ray."""
        radius, limit = np.hypot(distorted[:, 0], distorted[:, 1]), self._limit_rad
        angle = np.minimum(radius, limit)
        with np.errstate(all="ignore"):  # points without a ray end as NaN
            for _ in range(_NEWTON_STEPS):
                value, slope = polynomial(self.coefficients, angle)
                angle = np.clip(angle - (value - radius) / slope, 0.0, limit)
            value, _ = polynomial(self.coefficients, angle)
            solved = (np.abs(value - radius) < _SOLVED) & (angle < limit)
            scale = np.where(radius > 1e-12, np.tan(angle) / np.maximum(radius, 1e-12), 1.0)
        return np.where(solved[:, None], distorted * scale[:, None], np.nan)
