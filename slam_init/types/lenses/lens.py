"""A lens that maps rays of any angle: a profile, and the distortion of its coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slam_init.types.arrays import Bools, Floats
from slam_init.types.lenses.bending import STRAIGHT, Bending
from slam_init.types.lenses.profiles import Profile, Shape, profile_of_angle, project_profile, unproject_profile

# The field of a lens is found on a grid of angles, in rad: a tenth of a degree up to 179 degrees, in this many
# directions.
_ANGLES = np.radians(np.arange(0.0, 179.05, 0.1))
_DIRECTIONS = 16
# The field ends where a pixel tells an angle five times less well than on the axis: the smallest eigenvalue of the
# symmetric part of the derivatives is a fifth. As long as it is positive, the lens is invertible (Gale and Nikaido
# 1965: the Jacobian of a map of a convex region is positive definite). A fifth is left for the noise: an error of a
# pixel must not reach the radius at which the image stops growing.
_LEAST_SLOPE = 0.2
# A panorama ends half a degree before the seam at its left and right border: the rays of a track do not jump across.
_SEAM_RAD = math.radians(179.5)
# At this latitude an image of a panorama is stretched sixfold. Corners of the image there are corners of nothing else.
_MAX_LATITUDE_RAD = math.radians(80.0)
# Largest error of lens coordinates that are distorted again, over one plus their size: 1e-7 px for a focal length of
# 1000 px.
_SOLVED = 1e-10


@dataclass(frozen=True)
class Lens:
    """A lens in units of the focal length."""

    profile: Profile
    #: (float, float, float) The parameters of the profile.
    shape: Shape = (0.0, 0.0, 1.0)
    #: The distortion of its coordinates.
    bending: Bending = STRAIGHT

    @cached_property
    def magnification(self) -> float:
        """Lens coordinates per radian near the axis.

        * Returns: 1 for most models; the focal lengths times this number are those of a pinhole camera near the axis.
        """
        if self.profile == Profile.SPHERE:
            return 1 / (1 + self.shape[0])
        if self.profile == Profile.FIELD_OF_VIEW:
            return 2 * math.tan(self.shape[0] / 2) / self.shape[0]
        return 1.0

    @cached_property
    def max_angle_rad(self) -> float:
        """Largest angle between the axis and a ray that the lens sees."""
        if self.profile == Profile.PANORAMA:
            return math.pi
        radius, slope, reached = profile_of_angle(self.profile, self.shape, _ANGLES)
        with np.errstate(all="ignore"):  # beyond the field
            growth = self.bending.least_growth(radius, _DIRECTIONS)
            seen = reached & (slope * growth > _LEAST_SLOPE * self.magnification)
        return float(_ANGLES[max(int(np.argmin(seen)) - 1, 0)] if not seen.all() else _ANGLES[-1])

    @cached_property
    def _largest_radius(self) -> float:
        """Radius of the largest angle, before the distortion."""
        angles = np.array([self.max_angle_rad])
        return float(profile_of_angle(self.profile, self.shape, angles)[0][0])

    def sees(self, rays: Floats) -> Bools:
        """Tell which rays are within the field of the lens.

        Shapes: ``rays`` (N, 3), returns (N,).
        """
        X, Y, Z = rays[:, 0], rays[:, 1], rays[:, 2]
        if self.profile == Profile.PANORAMA:
            level = np.hypot(X, Z)
            return np.asarray(
                (level > 0)
                & (np.abs(np.arctan2(X, Z)) <= _SEAM_RAD)
                & (np.abs(np.arctan2(Y, level)) <= _MAX_LATITUDE_RAD)
            )
        side = np.hypot(X, Y)
        return np.asarray((np.arctan2(side, Z) <= self.max_angle_rad) & ((side > 0) | (Z > 0)))

    def project(self, rays: Floats) -> Floats:
        """Project rays to distorted lens coordinates.

        Shapes: ``rays`` (N, 3), returns (N, 2).
        """
        uv = self.bending.apply(project_profile(self.profile, self.shape, rays))
        return np.where(self.sees(rays)[:, None], uv, np.nan)

    def unproject(self, distorted: Floats) -> Floats:
        """Invert :meth:`project`.

        Shapes: ``distorted`` (N, 2), returns (N, 3).
        """
        if self.profile == Profile.PANORAMA:
            rays = unproject_profile(self.profile, self.shape, distorted)
            rays[np.abs(distorted[:, 0]) > _SEAM_RAD] = np.nan
            rays[~(np.abs(distorted[:, 1]) <= _MAX_LATITUDE_RAD)] = np.nan
            return rays
        uv = self.bending.invert(distorted, self._largest_radius)
        rays = unproject_profile(self.profile, self.shape, uv)
        with np.errstate(all="ignore"):  # points without a ray end as NaN
            errors = np.abs(self.bending.apply(uv) - distorted) / (1 + np.abs(distorted))
            solved = errors.max(axis=1, initial=0.0) < _SOLVED
            # A root beyond the field is another ray, which the lens polynomial maps to the same pixel.
            seen = np.hypot(uv[:, 0], uv[:, 1]) <= self._largest_radius * (1 + 1e-12)
        rays[~(solved & seen)] = np.nan
        return rays

    @property
    def field_limits(self) -> tuple[float, float]:
        """The limits of the field for the compiled projection.

        * Returns: Largest angle; for a panorama the largest longitude and latitude. In rad.
        """
        if self.profile == Profile.PANORAMA:
            return _SEAM_RAD, _MAX_LATITUDE_RAD
        return self.max_angle_rad, 0.0
