"""Profiles: how the rays of a lens become lens coordinates (u, v), without distortion.

With a ray (X, Y, Z) of unit length and ``r = |(X, Y)|``:

* sphere: ``(u, v) = (X, Y) / (a d + (1 - a) z)`` with ``z = xi + Z`` and ``d = sqrt(b r^2 + z^2)``. Perspective for
  ``xi = a = 0``; the unified (omnidirectional) model [1]_ for ``a = 0``; the double sphere [2]_ for ``b = 1``; the
  enhanced unified model EUCM [3]_ for ``xi = 0``.
* equidistant: ``|(u, v)|`` is the angle between the ray and the axis.
* field of view [4]_: ``|(u, v)| = atan(2 tan(w / 2) r / Z) / w``.
* panorama: u is the longitude ``atan2(X, Z)``, v the latitude ``atan2(Y, |(X, Z)|)``.

References
----------
.. [1] C. Mei, P. Rives, Single view point omnidirectional camera calibration from planar grids, ICRA 2007.
.. [2] V. Usenko, N. Demmel, D. Cremers, The double sphere camera model, 3DV 2018.
.. [3] B. Khomutenko, G. Garcia, P. Martinet, An enhanced unified camera model, RA-L 2016.
.. [4] F. Devernay, O. Faugeras, Straight lines have to be straight, MVA 2001.
"""

from __future__ import annotations

import enum
import math

import numpy as np

from slam_init.types.arrays import Bools, Floats

#: xi, a, b of a sphere; w of a field of view.
Shape = tuple[float, float, float]


class Profile(enum.IntEnum):
    """The kinds of profiles. The numbers are those of the compiled projection."""

    SPHERE = 0
    EQUIDISTANT = 1
    FIELD_OF_VIEW = 2
    PANORAMA = 3


# A perspective image ends at 89 degrees, where the denominator is this share of its value on the axis. The image of
# the other spheres ends at the same share.
_LEAST_DENOMINATOR = math.sin(math.radians(1.0))
# Below this radius the ratio of two small numbers is replaced by its limit.
_TINY = 1e-12


def project_profile(kind: Profile, shape: Shape, rays: Floats) -> Floats:
    """Project rays to lens coordinates.

    Shapes: ``rays`` (N, 3), returns (N, 2).

    * Returns: Any number, or NaN, for rays that the profile does not reach.
    """
    X, Y, Z = rays[:, 0], rays[:, 1], rays[:, 2]
    if kind == Profile.PANORAMA:
        return np.column_stack([np.arctan2(X, Z), np.arctan2(Y, np.hypot(X, Z))])
    r = np.hypot(X, Y)
    with np.errstate(all="ignore"):  # rays beyond the field may overflow; the lens knows its field
        if kind == Profile.SPHERE:
            xi, a, b = shape
            z = xi * np.hypot(r, Z) + Z
            scale = 1 / (a * np.sqrt(b * r * r + z * z) + (1 - a) * z)
        else:
            steep = 1.0 if kind == Profile.EQUIDISTANT else 2 * math.tan(shape[0] / 2)
            gain = 1.0 if kind == Profile.EQUIDISTANT else 1 / shape[0]
            near = r <= _TINY * np.abs(Z)
            scale = np.where(near, gain * steep / Z, gain * np.arctan2(steep * r, Z) / np.where(near, 1.0, r))
        return np.asarray(rays[:, :2] * scale[:, None])


def unproject_profile(kind: Profile, shape: Shape, uv: Floats) -> Floats:
    """Invert :func:`project_profile`.

    Shapes: ``uv`` (N, 2), returns (N, 3).
    """
    with np.errstate(all="ignore"):  # coordinates without a ray end as NaN
        if kind == Profile.PANORAMA:
            longitude, latitude = uv[:, 0], uv[:, 1]
            level = np.cos(latitude)
            rays = np.column_stack([np.sin(longitude) * level, np.sin(latitude), np.cos(longitude) * level])
            return np.where((np.abs(latitude) <= math.pi / 2)[:, None], rays, np.nan)
        radius = np.hypot(uv[:, 0], uv[:, 1])
        if kind == Profile.SPHERE:
            return _unproject_sphere(shape, uv, radius * radius)
        angle = radius
        if kind == Profile.FIELD_OF_VIEW:
            w = shape[0]
            angle = np.where(w * radius < math.pi / 2, np.arctan(np.tan(w * radius) / (2 * math.tan(w / 2))), np.nan)
        scale = np.where(radius > _TINY, np.sin(angle) / np.where(radius > _TINY, radius, 1.0), 1.0)
        return np.column_stack([uv * scale[:, None], np.cos(angle)])


def _unproject_sphere(shape: Shape, uv: Floats, r2: Floats) -> Floats:
    """Rays of the sphere: the inverse of EUCM gives the ray from the centre of the shifted sphere."""
    xi, a, b = shape
    z = (1 - b * a * a * r2) / (a * np.sqrt(1 - (2 * a - 1) * b * r2) + (1 - a))
    length = (z * xi + np.sqrt(z * z + (1 - xi * xi) * r2)) / (z * z + r2)
    rays = np.column_stack([length[:, None] * uv, length * z - xi])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def profile_of_angle(kind: Profile, shape: Shape, angles: Floats) -> tuple[Floats, Floats, Bools]:
    """Compute the radius of a profile that is symmetric about the axis.

    Shapes: ``angles`` (N,), returns ``radius`` (N,), returns ``slope`` (N,), returns ``reached`` (N,).
    """
    if kind == Profile.EQUIDISTANT:
        return angles, np.ones_like(angles), np.ones(len(angles), bool)
    sine, cosine = np.sin(angles), np.cos(angles)
    with np.errstate(all="ignore"):  # beyond the field
        if kind == Profile.FIELD_OF_VIEW:
            w, steep = shape[0], 2 * math.tan(shape[0] / 2)
            slope = steep / (w * (cosine**2 + (steep * sine) ** 2))
            return np.arctan2(steep * sine, cosine) / w, slope, cosine >= _LEAST_DENOMINATOR
        xi, a, b = shape
        z = xi + cosine
        d = np.sqrt(b * sine**2 + z * z)
        denominator = a * d + (1 - a) * z
        change = a * (b * sine * cosine - z * sine) / d - (1 - a) * sine
        slope = (cosine * denominator - sine * change) / denominator**2
        return sine / denominator, slope, denominator >= _LEAST_DENOMINATOR * (1 + xi)
