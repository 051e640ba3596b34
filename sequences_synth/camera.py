"""The cameras of the synthetic worlds: a pinhole with one coefficient of radial distortion, and wide lenses.

The lenses are written from the papers and manuals of the models. Each has usual parameters, and a field of view beyond
which its image is black. The formulas project; a ray of a pixel is found by Newton's method. Coefficients are in the
order of OpenCV and COLMAP.

======================  ============================================================================================
``radtan``              k1 k2 p1 p2: OpenCV
``rational``            k1 k2 p1 p2 k3 k4 k5 k6: OpenCV
``thin-prism``          k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4: OpenCV
``fisheye``             k1 k2 k3 k4: Kannala and Brandt, PAMI 2006, with odd powers of the angle only
``thin-prism-fisheye``  k1 k2 p1 p2 k3 k4 s1 s2: COLMAP
``fov``                 w: Devernay and Faugeras, MVA 2001
``omni``                xi k1 k2 p1 p2: Mei and Rives, ICRA 2007
``double-sphere``       xi alpha: Usenko, Demmel and Cremers, 3DV 2018
``eucm``                alpha beta: Khomutenko, Garcia and Martinet, RA-L 2016
``equirectangular``     longitude and latitude
======================  ============================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np

from sequences_synth.arrays import Floats


class _Usual(NamedTuple):
    """Usual parameters: focal length over the width of the image, coefficients, largest angle from the axis (deg)."""

    focal: float
    coefficients: tuple[float, ...]
    half_field_deg: float


_USUAL = {
    "radtan": _Usual(0.61, (-0.283, 0.074, 1.9e-4, 1.8e-5), 60.0),
    "rational": _Usual(0.5, (0.5, 0.1, 4e-4, -2e-4, 0.02, 0.75, 0.3, 0.03), 75.0),
    "thin-prism": _Usual(0.6, (-0.2, 0.05, 1e-3, -5e-4, 2e-3, 0.05, 0.01, 3e-3, 2e-3, -1e-3, -1e-3, 5e-4), 65.0),
    "fisheye": _Usual(0.3, (0.02, -0.01, 3e-3, -1e-3), 100.0),
    "thin-prism-fisheye": _Usual(0.3, (0.02, -0.01, 1e-3, -5e-4, 3e-3, -1e-3, 2e-3, -1e-3), 100.0),
    "fov": _Usual(0.4, (0.93,), 85.0),
    "omni": _Usual(0.7, (1.2, -0.1, 0.05, 5e-4, -3e-4), 100.0),
    "double-sphere": _Usual(0.3, (-0.2, 0.59), 100.0),
    "eucm": _Usual(0.35, (0.63, 1.05), 100.0),
    "equirectangular": _Usual(1 / (2 * math.pi), (), 180.0),
}
#: The names of the lenses.
LENSES = tuple(_USUAL)

# The angle of a pixel is read from a table of this many radii, then improved by Newton's method with the derivatives at
# the start. The table is exact to 1e-6 rad for radial models; other terms move a ray by a hundredth, and each step
# divides the error by a hundred or more. It ends at this error in pixels.
_TABLE, _NEWTON_STEPS, _EXACT_PX = 2000, 10, 1e-9
# Half of the step of the derivatives of Newton's method, rad.
_STEP_RAD = 1e-6


@dataclass(frozen=True)
class LensCamera:
    """A camera with a lens; all values in pixels, pixel centres at integer coordinates."""

    #: width, height: Image size.
    width: int
    height: int
    #: fx, fy, cx, cy: Factors of the lens coordinates, and principal point.
    fx: float
    fy: float
    cx: float
    cy: float
    #: One of :data:`LENSES`.
    model: str
    #: See the module docstring.
    coefficients: tuple[float, ...]
    #: Largest angle between the optical axis and a ray that is seen.
    half_field_rad: float

    def project(self, points: Floats) -> Floats:
        """Project points.

        Shapes: ``points`` (..., 3), returns (..., 2).
        """
        X, Y, Z = np.moveaxis(np.asarray(points, float), -1, 0)
        with np.errstate(all="ignore"):  # outside of the field of view
            u, v = _FORMULAS[self.model](X, Y, Z, self.coefficients)
        return np.stack([self.fx * u + self.cx, self.fy * v + self.cy], axis=-1)

    def rays(self, pixels: Floats) -> Floats:
        """Compute the rays of pixels.

        Shapes: ``pixels`` (..., 2), returns (..., 3).

        * Returns: Unit rays in the frame of the camera; 0 outside of the field of view.
        """
        seen = (np.asarray(pixels, float) - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.model == "equirectangular":
            longitude, latitude = seen[..., 0], seen[..., 1]
            ring = np.cos(latitude)
            rays = np.stack([ring * np.sin(longitude), np.sin(latitude), ring * np.cos(longitude)], axis=-1)
            inside = (np.abs(longitude) <= math.pi) & (np.abs(latitude) <= math.pi / 2)
            return np.where(inside[..., None], rays, 0.0)
        angles = np.linspace(0, self.half_field_rad, _TABLE)
        target = np.linalg.norm(seen, axis=-1)
        along = np.stack([np.sin(angles), np.zeros(_TABLE), np.cos(angles)], axis=-1)
        table = np.linalg.norm((self.project(along) - (self.cx, self.cy)) / (self.fx, self.fy), axis=-1)
        angle = np.interp(target, table, angles)
        # Angle times direction in the image: two unknowns that are smooth on the axis too.
        place = seen * (angle / np.where(target > 0, target, 1.0))[..., None]
        a, b = (
            (self.project(_ray(place + step)) - self.project(_ray(place - step))) / (2 * _STEP_RAD)
            for step in _STEP_RAD * np.eye(2)
        )
        determinant = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        for _ in range(_NEWTON_STEPS):
            error = self.project(_ray(place)) - pixels
            if not (np.abs(error) > _EXACT_PX).any():
                break
            with np.errstate(all="ignore"):
                change = np.stack(
                    [
                        (b[..., 1] * error[..., 0] - b[..., 0] * error[..., 1]) / determinant,
                        (a[..., 0] * error[..., 1] - a[..., 1] * error[..., 0]) / determinant,
                    ],
                    axis=-1,
                )
            # Outside of the field of view the formula may be flat; the place stays finite.
            place = place - np.clip(np.nan_to_num(change), -0.1, 0.1)
        inside = np.linalg.norm(place, axis=-1) <= self.half_field_rad
        inside &= np.linalg.norm(np.nan_to_num(self.project(_ray(place)) - pixels, nan=1e9), axis=-1) < 1e-6
        return np.where(inside[..., None], _ray(place), 0.0)


def lens_camera(model: str, width: int, height: int) -> LensCamera:
    """Make a camera with the usual parameters of a model."""
    usual = _USUAL[model]
    fx = usual.focal * width
    fy = height / math.pi if model == "equirectangular" else fx
    centre = (width - 1) / 2, (height - 1) / 2
    return LensCamera(width, height, fx, fy, *centre, model, usual.coefficients, math.radians(usual.half_field_deg))


@lru_cache(maxsize=4)
def sample_rays(camera: LensCamera, per_pixel: int) -> Floats:
    """Compute the rays of a grid of samples.

    Shapes: returns (H, W, 3).

    * ``per_pixel``: 1: the centres of the pixels; 2: two rows and two columns of samples in each pixel.
    """
    first = 0.5 / per_pixel - 0.5
    x, y = (first + np.arange(per_pixel * side) / per_pixel for side in (camera.width, camera.height))
    rays = camera.rays(np.stack(np.meshgrid(x, y), axis=-1))
    rays.setflags(write=False)
    return rays


def _ray(place: Floats) -> Floats:
    """Unit rays (..., 3) at an angle |place| from the axis, in the direction of place (..., 2)."""
    angle = np.linalg.norm(place, axis=-1, keepdims=True)
    return np.concatenate([place * np.sinc(angle / np.pi), np.cos(angle)], axis=-1)


Pair = tuple[Floats, Floats]


def _opencv(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    """OpenCV's model with 4, 8 or 12 coefficients."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (*k, *(12 - len(k)) * [0.0])
    x, y = X / Z, Y / Z
    r2 = x**2 + y**2
    bend = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x**2) + s1 * r2 + s2 * r2**2
    v = y * bend + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2
    return u, v


def _equidistant(X: Floats, Y: Floats, Z: Floats) -> Pair:
    """Angle from the axis times the direction in the image."""
    side = np.hypot(X, Y)
    angle = np.arctan2(side, Z)
    side = np.where(side > 0, side, 1.0)
    return angle * X / side, angle * Y / side


def _fisheye(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    u, v = _equidistant(X, Y, Z)
    t2 = u**2 + v**2
    bend = 1 + k[0] * t2 + k[1] * t2**2 + k[2] * t2**3 + k[3] * t2**4
    return u * bend, v * bend


def _thin_prism_fisheye(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    k1, k2, p1, p2, k3, k4, s1, s2 = k
    u, v = _equidistant(X, Y, Z)
    t2 = u**2 + v**2
    radial = k1 * t2 + k2 * t2**2 + k3 * t2**3 + k4 * t2**4
    du = u * radial + 2 * p1 * u * v + p2 * (t2 + 2 * u**2) + s1 * t2
    dv = v * radial + 2 * p2 * u * v + p1 * (t2 + 2 * v**2) + s2 * t2
    return u + du, v + dv


def _fov(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    (w,) = k
    ideal = np.hypot(X, Y) / Z
    bend = np.where(ideal > 1e-9, np.arctan(2 * ideal * math.tan(w / 2)) / (w * ideal), 2 * math.tan(w / 2) / w)
    return X / Z * bend, Y / Z * bend


def _omni(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    xi, *radtan = k
    mirror = Z + xi * np.sqrt(X**2 + Y**2 + Z**2)
    return _opencv(X, Y, mirror, tuple(radtan))


def _double_sphere(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    xi, alpha = k
    shifted = Z + xi * np.sqrt(X**2 + Y**2 + Z**2)
    depth = alpha * np.sqrt(X**2 + Y**2 + shifted**2) + (1 - alpha) * shifted
    return X / depth, Y / depth


def _eucm(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> Pair:
    alpha, beta = k
    depth = alpha * np.sqrt(beta * (X**2 + Y**2) + Z**2) + (1 - alpha) * Z
    return X / depth, Y / depth


def _equirectangular(X: Floats, Y: Floats, Z: Floats, _: tuple[float, ...]) -> Pair:
    return np.arctan2(X, Z), np.arctan2(Y, np.hypot(X, Z))


_FORMULAS = {
    "radtan": _opencv,
    "rational": _opencv,
    "thin-prism": _opencv,
    "fisheye": _fisheye,
    "thin-prism-fisheye": _thin_prism_fisheye,
    "fov": _fov,
    "omni": _omni,
    "double-sphere": _double_sphere,
    "eucm": _eucm,
    "equirectangular": _equirectangular,
}


# -- pinhole ---------------------------------------------------------------------------------------


# Newton's method for the radius of an undistorted pixel. For coefficients within the range of the options, 8 steps
# reach a residual below 1e-12; the others are a margin.
_RADIUS_STEPS = 20


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
        for _ in range(_RADIUS_STEPS):
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
