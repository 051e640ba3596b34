"""The lenses of cameras: how their rays become places in the image, and back.

A :class:`LensModel` is a profile, which maps rays of any angle to lens coordinates (u, v), and a distortion of these
coordinates. The pixel is ``(fx u' + cx, fy v' + cy)`` with the distorted coordinates (u', v'). The inverse of the
distortion is Newton's method for all models (:mod:`slam_init.lenses.undistortion`).

The field of ``pinhole``, ``radtan`` and a ``fisheye`` whose image ends before 89 degrees is a part of the plane z = 1:
up to the radius at which the distorted radius stops growing. That of the others ends earlier, at the angle from which
on a pixel has too little information about the ray.

**Profiles** map the rays of a lens to lens coordinates (u, v), without distortion. With a ray (X, Y, Z) of unit length
and ``r = |(X, Y)|``:

* sphere: ``(u, v) = (X, Y) / (a d + (1 - a) z)`` with ``z = xi + Z`` and ``d = sqrt(b r^2 + z^2)``. Perspective for
  ``xi = a = 0``; the unified (omnidirectional) model [1]_ for ``a = 0``; the double sphere [2]_ for ``b = 1``; the
  enhanced unified model EUCM [3]_ for ``xi = 0``.
* equidistant: ``|(u, v)|`` is the angle between the ray and the axis.
* field of view [4]_: ``|(u, v)| = atan(2 tan(w / 2) r / Z) / w``.
* panorama: u is the longitude ``atan2(X, Z)``, v the latitude ``atan2(Y, |(X, Z)|)``.

**The distortion** is a ratio of radial polynomials, with tangential terms and thin prism terms. With
``s = u^2 + v^2`` ::

    u' = u N(s) / D(s) + 2 p1 u v + p2 (s + 2 u^2) + s1 s + s2 s^2
    v' = v N(s) / D(s) + p1 (s + 2 v^2) + 2 p2 u v + s3 s + s4 s^2
    N = 1 + n1 s + n2 s^2 + n3 s^3 + n4 s^4        D = 1 + d1 s + d2 s^2 + d3 s^3

This is OpenCV's model with 12 coefficients (n4 = 0), and the model of COLMAP's THIN_PRISM_FISHEYE (d = 0, s2 = s4 = 0).

**Models** and their coefficients:

======================  ============================================  =============================================
name                    coefficients                                  in other formats
======================  ============================================  =============================================
``pinhole``             none
``radtan``              k1 k2 p1 p2 [k3]                              OpenCV, Kalibr radtan, COLMAP OPENCV
``rational``            k1 k2 p1 p2 k3 k4 k5 k6                       OpenCV, ROS rational_polynomial, FULL_OPENCV
``thin-prism``          k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4           OpenCV with 12 coefficients
``fisheye``             k1 k2 k3 k4                                   Kannala-Brandt: OpenCV fisheye, equidistant, kb4
``thin-prism-fisheye``  k1 k2 p1 p2 k3 k4 s1 s2                       COLMAP THIN_PRISM_FISHEYE
``fov``                 w [b]                                         Devernay and Faugeras: ATAN, COLMAP FOV
``omni``                xi [k1 k2 p1 p2]                              Mei: Kalibr omni, Basalt ucm
``double-sphere``       xi alpha [b]                                  Kalibr and Basalt ds
``eucm``                alpha beta [b]                                Kalibr and Basalt eucm
``equirectangular``     none                                          panorama of longitudes and latitudes
======================  ============================================  =============================================

``b`` is no part of these models. It is the radial distortion of the lens coordinates that a calibration may lack:
``(u, v) (1 + b (u^2 + v^2))``.

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
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_init.errors import CalibrationError

Floats = NDArray[np.float64]

#: xi, a, b of a sphere; w of a field of view.
Shape = tuple[float, float, float]


class Profile(enum.IntEnum):
    """The kinds of profiles. The numbers are those of the compiled projection."""

    SPHERE = 0
    EQUIDISTANT = 1
    FIELD_OF_VIEW = 2
    PANORAMA = 3


#: The profile of a plane image.
PERSPECTIVE = (Profile.SPHERE, (0.0, 0.0, 1.0))

# A perspective image ends at 89 degrees, where the denominator is this share of its value on the axis. The image of
# the other spheres ends at the same share.
_LEAST_DENOMINATOR = math.sin(math.radians(1.0))
# Below this radius the ratio of two small numbers is replaced by its limit.
_TINY = 1e-12


# Of the derivatives of the distortion: its square is nothing beside any number.
_IMAGINARY_STEP = 1e-30


class Bending(NamedTuple):
    """The coefficients of the distortion, of which the module docstring has the formula."""

    #: n1, n2, n3, n4: Of the numerator.
    n1: float = 0.0
    n2: float = 0.0
    n3: float = 0.0
    n4: float = 0.0
    #: d1, d2, d3: Of the denominator.
    d1: float = 0.0
    d2: float = 0.0
    d3: float = 0.0
    #: p1, p2: Tangential.
    p1: float = 0.0
    p2: float = 0.0
    #: s1, s2, s3, s4: Of the thin prism.
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0

    def radial(self, radius: Floats) -> Floats:
        """Compute the distorted radius by the radial terms alone.

        Shapes: ``radius`` (N,), returns (N,).
        """
        return np.asarray(radius * self._ratio(radius * radius)[0])

    def apply(self, uv: NDArray[Any]) -> NDArray[Any]:
        """Distort lens coordinates.

        Shapes: ``uv`` (N, 2), returns (N, 2).
        """
        u, v = uv[:, 0], uv[:, 1]
        s = u * u + v * v
        ratio, _ = self._ratio(s)
        return np.column_stack(
            [
                u * ratio + 2 * self.p1 * u * v + self.p2 * (s + 2 * u * u) + s * (self.s1 + s * self.s2),
                v * ratio + self.p1 * (s + 2 * v * v) + 2 * self.p2 * u * v + s * (self.s3 + s * self.s4),
            ]
        )

    def least_growth(self, radius: Floats, directions: int) -> Floats:
        """Compute by how much a small step of the coordinates moves the distorted ones at least.

        Shapes: ``radius`` (N,), returns (N,).

        * ``directions``: Number of directions that are tried, where the distortion is not symmetric about the axis.
        * Returns: Smallest eigenvalue of the symmetric part of the Jacobian; negative where D is not positive.
        """
        directions = directions if any(self[7:]) else 1
        angles = 2 * np.pi / directions * np.arange(directions)
        uv = (radius[:, None, None] * np.column_stack([np.cos(angles), np.sin(angles)])).reshape(-1, 2)
        # The derivatives by imaginary steps are exact, since no difference is taken.
        columns = (np.imag(self.apply(uv + 1j * axis)) for axis in _IMAGINARY_STEP * np.eye(2))
        J = np.stack(list(columns), axis=-1) / _IMAGINARY_STEP
        middle, half = 0.5 * (J[:, 0, 0] + J[:, 1, 1]), 0.5 * (J[:, 0, 0] - J[:, 1, 1])
        eigenvalues = middle - np.hypot(half, 0.5 * (J[:, 0, 1] + J[:, 1, 0]))
        _, denominator = self._ratio(radius * radius)
        return np.asarray(np.where(denominator > 0, eigenvalues.reshape(-1, directions).min(axis=1), -1.0))

    def _ratio(self, s: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """N / D, and D."""
        n1, n2, n3, n4, d1, d2, d3 = self[:7]
        N, D = 1 + s * (n1 + s * (n2 + s * (n3 + s * n4))), 1 + s * (d1 + s * (d2 + s * d3))
        with np.errstate(all="ignore"):  # beyond the field
            return np.asarray(N / D), np.asarray(D)


#: No distortion.
STRAIGHT = Bending()


# The field of a lens is found on a grid of angles, in rad: a tenth of a degree up to 179 degrees, in this many
# directions.
_ANGLES = np.radians(np.arange(0.0, 179.05, 0.1))
_DIRECTIONS = 16
# The field ends where a pixel measures an angle five times less well than on the axis: the smallest eigenvalue of the
# symmetric part of the derivatives is a fifth. As long as it is positive, the lens is invertible (Gale and Nikaido
# 1965: the Jacobian of a map of a convex region is positive definite). A fifth is left for the noise: an error of a
# pixel must not reach the radius at which the image stops growing.
_LEAST_SLOPE = 0.2
# A panorama ends half a degree before the seam at its left and right border: the rays of a track do not jump across.
_SEAM_RAD = math.radians(179.5)
# At this latitude an image of a panorama is stretched sixfold. Corners of the image there are corners of nothing else.
_MAX_LATITUDE_RAD = math.radians(80.0)
#: Rays are represented on the plane z = 1, which ends at 90 degrees.
MAX_PLANAR_ANGLE_RAD = math.radians(89.0)
# Nodes of the table of distorted radii from which the inverse of the distortion begins.
_NODES = 2000


@dataclass(frozen=True)
class LensModel:
    """A lens in units of the focal length."""

    profile: Profile
    #: (float, float, float) The parameters of the profile.
    shape: Shape = (0.0, 0.0, 1.0)
    #: The distortion of its coordinates.
    bending: Bending = STRAIGHT
    #: Whether the field is a part of the plane z = 1.
    is_planar: bool = False

    @property
    def is_perspective(self) -> bool:
        """Whether the lens coordinates are those of the plane z = 1."""
        return (self.profile, self.shape) == PERSPECTIVE

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
        if self.is_planar:
            return math.atan(self.largest_radius) if self.is_perspective else self.largest_radius
        radius, step = self._radius(_ANGLES), _ANGLES[1] / 100
        slope = (self._radius(_ANGLES + step) - self._radius(_ANGLES - step)) / (2 * step)
        reached = np.ones(len(_ANGLES), bool)
        if self.profile == Profile.FIELD_OF_VIEW:
            reached = np.cos(_ANGLES) >= _LEAST_DENOMINATOR
        elif self.profile == Profile.SPHERE:
            reached = (radius >= 0) & (radius * _LEAST_DENOMINATOR * (1 + self.shape[0]) <= np.sin(_ANGLES))
        with np.errstate(all="ignore"):  # beyond the field
            growth = self.bending.least_growth(radius, _DIRECTIONS)
            seen = reached & (slope * growth > _LEAST_SLOPE * self.magnification)
        return float(_ANGLES[max(int(np.argmin(seen)) - 1, 0)] if not seen.all() else _ANGLES[-1])

    def _radius(self, angles: Floats) -> Floats:
        """Radii (N,) of angles (N,) before the distortion, for profiles that are symmetric about the axis."""
        if self.profile == Profile.EQUIDISTANT:
            return angles
        side, depth = np.sin(angles), np.cos(angles)
        if self.profile == Profile.FIELD_OF_VIEW:
            w = self.shape[0]
            return np.asarray(np.arctan2(2 * math.tan(w / 2) * side, depth) / w)
        xi, a, b = self.shape
        with np.errstate(all="ignore"):  # angles beyond the field may overflow
            return np.asarray(side / (a * np.hypot(math.sqrt(b) * side, xi + depth) + (1 - a) * (xi + depth)))

    @cached_property
    def largest_radius(self) -> float:
        """Radius of the lens coordinates at which the field ends."""
        if self.is_planar:
            return turning_radius(self.bending[:4], math.inf if self.is_perspective else MAX_PLANAR_ANGLE_RAD)
        return float(self._radius(np.array([self.max_angle_rad]))[0])

    @cached_property
    def _table(self) -> tuple[Floats, Floats]:
        """Distorted radii over the field, and the radii before the distortion."""
        radii = np.linspace(0.0, self.largest_radius, _NODES)
        return self.bending.radial(radii), radii

    def undistort(self, distorted: Floats) -> Floats:
        """Compute the lens coordinates of distorted ones.

        Shapes: ``distorted`` (N, 2), returns (N, 2).

        * Returns: NaN where there is no ray.
        """
        if self.profile == Profile.PANORAMA:
            seen = np.all(np.abs(distorted) <= (_SEAM_RAD, _MAX_LATITUDE_RAD), axis=1)
            return np.where(seen[:, None], distorted, np.nan)
        return self._undistorted(distorted)[:, :2]

    def _undistorted(self, distorted: Floats) -> Floats:
        """The lens coordinates, and the length of (u, v, 1), of distorted ones (N, 2): (N, 3)."""
        limit = self.largest_radius * (1 + 1e-12)
        if self.bending == STRAIGHT:
            square = np.einsum("nq,nq->n", distorted, distorted)
            found = np.column_stack([distorted, np.sqrt(square + 1)])
            found[~(square <= limit * limit)] = np.nan
            return found
        from slam_init.lenses.undistortion import undistorted

        return undistorted(np.ascontiguousarray(distorted), self._start(distorted), np.array(self.bending), limit)

    def _start(self, distorted: Floats) -> Floats:
        """Where Newton's method begins: at the radius of the table, for the radial terms alone.

        On the plane it begins at the distorted coordinates. It converges monotonically from there for barrel and for
        pincushion lenses (the profile is concave or convex), and the tangential part is small.
        """
        if self.is_planar and self.is_perspective:
            return distorted
        target = np.hypot(distorted[:, 0], distorted[:, 1])
        return distorted * (np.interp(target, *self._table) / np.where(target > 0, target, 1.0))[:, None]

    def unproject(self, distorted: Floats) -> Floats:
        """The rays of distorted lens coordinates.

        Shapes: ``distorted`` (N, 2), returns (N, 3).
        """
        if self.is_perspective:
            found = self._undistorted(distorted)
            length = found[:, 2:].copy()
            found[:, 2] = 1.0
            return np.asarray(found / length)
        uv = self.undistort(distorted)
        with np.errstate(all="ignore"):  # coordinates without a ray end as NaN
            if self.profile == Profile.PANORAMA:
                longitude, latitude = uv[:, 0], uv[:, 1]
                level = np.cos(latitude)
                rays = np.column_stack([np.sin(longitude) * level, np.sin(latitude), np.cos(longitude) * level])
                return np.where((np.abs(latitude) <= math.pi / 2)[:, None], rays, np.nan)
            radius = np.hypot(uv[:, 0], uv[:, 1])
            if self.profile == Profile.SPHERE:
                # The inverse of EUCM gives the ray from the centre of the shifted sphere.
                xi, a, b = self.shape
                r2 = radius * radius
                z = (1 - b * a * a * r2) / (a * np.sqrt(1 - (2 * a - 1) * b * r2) + (1 - a))
                length = (z * xi + np.sqrt(z * z + (1 - xi * xi) * r2)) / (z * z + r2)
                rays = np.column_stack([length[:, None] * uv, length * z - xi])
                return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
            angle = radius
            if self.profile == Profile.FIELD_OF_VIEW:
                w = self.shape[0]
                angle = np.arctan(np.tan(w * radius) / (2 * math.tan(w / 2)))
                angle = np.where(w * radius < math.pi / 2, angle, np.nan)
            scale = np.where(radius > _TINY, np.sin(angle) / np.where(radius > _TINY, radius, 1.0), 1.0)
            return np.column_stack([uv * scale[:, None], np.cos(angle)])

    @property
    def numbers(self) -> Floats:
        """The lens for the compiled projection (:mod:`slam_init.lenses.ray`).

        Shapes: returns (20,).
        """
        limits, bent = (self.max_angle_rad, 0.0), 1 / self.magnification**2
        if self.profile == Profile.PANORAMA:
            limits, bent = (_SEAM_RAD, _MAX_LATITUDE_RAD), 0.0
        return np.array([self.profile, *self.shape, *self.bending, *limits, bent], float)


def turning_radius(k: tuple[float, ...], limit: float) -> float:
    """Find the radius at which ``r (1 + k1 r^2 + ...)`` stops growing."""
    # The slope is a polynomial in s = r^2. At its smallest positive root the distorted radius stops growing.
    # A coefficient below 1e-100 moves nothing, and a division by it overflows.
    coefficients = [(2 * i + 1) * ki if abs(ki) > 1e-100 else 0.0 for i, ki in enumerate(k, start=1)]
    roots = np.roots([*reversed(coefficients), 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return min(limit, float(np.sqrt(real.min()))) if len(real) else limit


#: The names of the coefficients of each model; those after a bar may be absent, all or none of them.
COEFFICIENTS: dict[str, str] = {
    "pinhole": "",
    "radtan": "k1 k2 p1 p2 | k3",
    "fisheye": "k1 k2 k3 k4",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6",
    "thin-prism": "k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4",
    "thin-prism-fisheye": "k1 k2 p1 p2 k3 k4 s1 s2",
    "fov": "w | b",
    "omni": "xi | k1 k2 p1 p2",
    "double-sphere": "xi alpha | b",
    "eucm": "alpha beta | b",
    "equirectangular": "",
}

#: The least and the largest values of the parameters of profiles, which come first.
_RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "fov": {"w": (1e-3, 3.14159)},
    "omni": {"xi": (0.0, 100.0)},
    "double-sphere": {"xi": (-0.999999, 1.0), "alpha": (0.0, 0.999999)},
    "eucm": {"alpha": (0.0, 1.0), "beta": (1e-6, 100.0)},
}

#: The coefficients to which more radial distortion is added; models without one are not bent.
_FIRST_RADIAL = ("k1", "b")

#: The degrees of the terms of the coefficients of perspective models, less one.
_DEGREES = {"k1": 2, "k2": 4, "p1": 1, "p2": 1, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s1": 1, "s2": 3, "s3": 1, "s4": 3}


def _names(model: str) -> list[str]:
    return COEFFICIENTS[model].replace("|", " ").split()


def check_coefficients(model: str, coefficients: tuple[float, ...]) -> None:
    """Refuse coefficients that a model does not take."""
    names = _names(model)
    sizes = sorted({len(COEFFICIENTS[model].partition("|")[0].split()), len(names)})
    if len(coefficients) not in sizes:
        allowed = " or ".join(str(n) for n in sizes)
        order = f" ({' '.join(names)})" if names else ""
        raise CalibrationError(
            f"{len(coefficients)} distortion coefficients for a {model} camera: give {allowed}{order}"
        )
    for (name, (low, high)), value in zip(_RANGES.get(model, {}).items(), coefficients, strict=False):
        if not low <= value <= high:
            raise CalibrationError(f"{name} of a {model} camera is {value!r}: it must be from {low:g} to {high:g}")


@lru_cache(maxsize=256)
def lens_of(model: str, coefficients: tuple[float, ...], is_planar: bool = False) -> LensModel:
    """Make the lens of a model."""
    k = coefficients
    if model == "equirectangular":
        return LensModel(Profile.PANORAMA)
    if model == "fisheye":
        return LensModel(Profile.EQUIDISTANT, bending=Bending(*k), is_planar=is_planar)
    if model == "thin-prism-fisheye":
        bending = Bending(n1=k[0], n2=k[1], n3=k[4], n4=k[5], p1=k[2], p2=k[3], s1=k[6], s3=k[7])
        return LensModel(Profile.EQUIDISTANT, bending=bending)
    if model == "fov":
        return LensModel(Profile.FIELD_OF_VIEW, (k[0], 0.0, 0.0), Bending(*k[1:]))
    if model == "omni":
        bending = Bending(n1=k[1], n2=k[2], p1=k[3], p2=k[4]) if len(k) == 5 else STRAIGHT
        return LensModel(Profile.SPHERE, (k[0], 0.0, 1.0), bending)
    if model == "double-sphere":
        return LensModel(Profile.SPHERE, (k[0], k[1], 1.0), Bending(*k[2:]))
    if model == "eucm":
        return LensModel(Profile.SPHERE, (0.0, k[0], k[1]), Bending(*k[2:]))
    # OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, of which a model has the first ones.
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (*k, *(12 - len(k)) * (0.0,))
    return LensModel(*PERSPECTIVE, Bending(k1, k2, k3, 0.0, k4, k5, k6, p1, p2, s1, s2, s3, s4), is_planar)


def bent_coefficients(model: str, coefficients: tuple[float, ...], k1: float) -> tuple[float, ...]:
    """Add radial distortion to the coefficients of a model.

    * ``k1``: Relative change of the radius of the image, at a radius of one focal length near the axis.
    * Returns: The same ones for a panorama, which is defined by its angles.
    """
    names = _names(model)
    place = next((i for i, name in enumerate(names) if name in _FIRST_RADIAL), None)
    if place is None:
        return coefficients
    values = [*coefficients, *(len(names) - len(coefficients)) * [0.0]]
    # radtan keeps its number of coefficients; its fifth one is no first one.
    values = values[: max(len(coefficients), place + 1)] if model != "omni" else values
    values[place] += k1 / lens_of(model, coefficients).magnification ** 2
    return tuple(values)


def scaled_coefficients(model: str, coefficients: tuple[float, ...], factor: float) -> tuple[float, ...]:
    """Convert the coefficients of a perspective model to units of a longer focal length."""
    return tuple(k * factor ** _DEGREES[name] for name, k in zip(_names(model), coefficients, strict=False))
