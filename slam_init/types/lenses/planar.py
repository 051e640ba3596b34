"""The lens models on the plane z = 1: OpenCV's radial-tangential model and its equidistant (fisheye) model."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from slam_init.types.arrays import Floats

# Newton's method doubles the number of correct digits in each step. Real lenses need 4 to 8 steps; pixels near the
# radius at which the lens polynomial stops growing need more.
_NEWTON_STEPS = 30
# Largest residual on the plane z = 1 of an undistorted pixel: 1e-7 px for a focal length of 1000 px.
_SOLVED = 1e-10
#: Rays are represented on the plane z = 1, which ends at 90 degrees.
MAX_PLANAR_ANGLE_RAD = math.radians(89.0)


def radial_part(distortion: tuple[float, ...]) -> tuple[float, ...]:
    """Pick the radial coefficients ``k1, k2[, k3]`` of radtan ones."""
    return (*distortion[:2], *distortion[4:])


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


def distort_radtan(xy: Floats, distortion: tuple[float, ...]) -> Floats:
    """Distort points of the plane z = 1.

    Shapes: ``xy`` (N, 2), returns (N, 2).
    """
    return np.column_stack(_distorted(xy[:, 0], xy[:, 1], distortion)[:2])


def _distorted(x: Floats, y: Floats, distortion: tuple[float, ...]) -> tuple[Floats, Floats, Floats, Floats]:
    """Both coordinates of distorted points, the squares of their ideal radii and the radial factors."""
    k1, k2, p1, p2, k3 = (*distortion, 0.0)[:5]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return distorted_x, distorted_y, r2, radial


def undistort_radtan(distorted: Floats, distortion: tuple[float, ...]) -> Floats:
    """Invert :func:`distort_radtan`.

    Newton's method starts from the distorted point. For the radial part alone it converges monotonically, for barrel
    and for pincushion lenses (the profile is concave or convex). The tangential part is small.

    Shapes: ``distorted`` (N, 2), returns (N, 2).
    """
    k1, k2, p1, p2, k3 = (*distortion, 0.0)[:5]
    wanted_x, wanted_y = np.ascontiguousarray(distorted.T)
    x, y = wanted_x, wanted_y
    with np.errstate(all="ignore"):  # points without a ray may overflow; they end as NaN
        for _ in range(_NEWTON_STEPS):
            distorted_x, distorted_y, r2, radial = _distorted(x, y, distortion)
            left_x, left_y = distorted_x - wanted_x, distorted_y - wanted_y
            radial_slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d r2, times 2
            jxx = radial + x * x * radial_slope + 2 * p1 * y + 6 * p2 * x
            jxy = x * y * radial_slope + 2 * p1 * x + 2 * p2 * y
            jyy = radial + y * y * radial_slope + 6 * p1 * y + 2 * p2 * x
            determinant = jxx * jyy - jxy * jxy
            step_x = (jyy * left_x - jxy * left_y) / determinant
            step_y = (jxx * left_y - jxy * left_x) / determinant
            x, y = x - step_x, y - step_y
            if np.all(np.abs(step_x) < 1e-13) and np.all(np.abs(step_y) < 1e-13):
                break
        xy = np.column_stack([x, y])
        residual = distort_radtan(xy, distortion) - distorted
        solved = np.abs(residual).max(axis=1, initial=0.0) < _SOLVED
        # A root beyond the turning radius is another ray, which the lens polynomial maps to the same pixel.
        seen = np.hypot(xy[:, 0], xy[:, 1]) < turning_radius(radial_part(distortion), np.inf)
    xy[~(solved & seen)] = np.nan
    return xy


def distort_fisheye(xy: Floats, distortion: tuple[float, ...]) -> Floats:
    """Distort points of the plane z = 1: their distorted radius is a polynomial of the angle.

    Shapes: ``xy`` (N, 2), returns (N, 2).
    """
    radius = np.hypot(xy[:, 0], xy[:, 1])
    distorted, _ = polynomial(distortion, np.arctan(radius))
    return np.asarray(xy * np.where(radius > 1e-12, distorted / np.maximum(radius, 1e-12), 1.0)[:, None])


def undistort_fisheye(distorted: Floats, distortion: tuple[float, ...]) -> Floats:
    """Invert :func:`distort_fisheye`.

    Shapes: ``distorted`` (N, 2), returns (N, 2).
    """
    radius = np.hypot(distorted[:, 0], distorted[:, 1])
    limit = turning_radius(distortion, MAX_PLANAR_ANGLE_RAD)
    angle = np.minimum(radius, limit)
    with np.errstate(all="ignore"):  # points without a ray end as NaN
        for _ in range(_NEWTON_STEPS):
            value, slope = polynomial(distortion, angle)
            angle = np.clip(angle - (value - radius) / slope, 0.0, limit)
        value, _ = polynomial(distortion, angle)
        solved = (np.abs(value - radius) < _SOLVED) & (angle < limit)
        scale = np.where(radius > 1e-12, np.tan(angle) / np.maximum(radius, 1e-12), 1.0)
    return np.where(solved[:, None], distorted * scale[:, None], np.nan)
