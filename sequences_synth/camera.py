"""The cameras of the synthetic worlds: a pinhole with one coefficient of radial distortion, and two lenses.

The lenses are written from the papers of the models. Each has usual parameters, and a field of view beyond which its
image is black. The formulas project; a ray of a pixel is found by Newton's method. Coefficients are in the order of
OpenCV.

===========  ==================================================================================
``radtan``   k1 k2 p1 p2: OpenCV
``fisheye``  k1 k2 k3 k4: Kannala and Brandt, PAMI 2006, with odd powers of the angle only
===========  ==================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np

from sequences_synth.arrays import Floats


class _Usual(NamedTuple):
    """Usual parameters: focal length over the width of the image, coefficients, largest angle from the axis (deg)."""

    focal: float
    coefficients: tuple[float, ...]
    half_field_deg: float


_USUAL = {
    "radtan": _Usual(0.61, (-0.283, 0.074, 1.9e-4, 1.8e-5), 60.0),
    "fisheye": _Usual(0.3, (0.02, -0.01, 3e-3, -1e-3), 100.0),
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
    centre = (width - 1) / 2, (height - 1) / 2
    return LensCamera(width, height, fx, fx, *centre, model, usual.coefficients, math.radians(usual.half_field_deg))


def _ray(place: Floats) -> Floats:
    """Unit rays (..., 3) at an angle |place| from the axis, in the direction of place (..., 2)."""
    angle = np.linalg.norm(place, axis=-1, keepdims=True)
    return np.concatenate([place * np.sinc(angle / np.pi), np.cos(angle)], axis=-1)


def _radtan(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> tuple[Floats, Floats]:
    k1, k2, p1, p2 = k
    x, y = X / Z, Y / Z
    r2 = x**2 + y**2
    bend = 1 + k1 * r2 + k2 * r2**2
    u = x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * bend + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return u, v


def _fisheye(X: Floats, Y: Floats, Z: Floats, k: tuple[float, ...]) -> tuple[Floats, Floats]:
    side = np.hypot(X, Y)
    angle = np.arctan2(side, Z)
    side = np.where(side > 0, side, 1.0)
    u, v = angle * X / side, angle * Y / side
    t2 = u**2 + v**2
    bend = 1 + k[0] * t2 + k[1] * t2**2 + k[2] * t2**3 + k[3] * t2**4
    return u * bend, v * bend


_FORMULAS = {"radtan": _radtan, "fisheye": _fisheye}


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

    #: Rays farther from the optical axis lie outside of every image.
    half_field_rad: ClassVar[float] = math.radians(89.0)

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
AnyCamera = PinholeCamera | LensCamera
_Same = TypeVar("_Same", bound=AnyCamera)


def stated_camera(true: _Same, focal_error: float, principal_error: float, rng: np.random.Generator) -> _Same:
    """Make the camera that the data state, which lacks the distortion of a pinhole and may have wrong values.

    * ``focal_error``: The stated focal length is the true one times ``1 + focal_error``.
    * ``principal_error``: Horizontal error of the principal point over the width, and vertical error over the height.
    """
    right, down = rng.choice([-1.0, 1.0], 2).tolist()
    stated: _Same = replace(true, k1=0.0) if isinstance(true, PinholeCamera) else true
    return replace(
        stated,
        fx=true.fx * (1 + focal_error),
        fy=true.fy * (1 + focal_error),
        cx=true.cx + right * principal_error * true.width,
        cy=true.cy + down * principal_error * true.height,
    )


#: What a pixel sees, three coordinates: of a lens its ray, else (u, v, 1) where a pinhole without distortion sees it.
Sights = tuple[Floats, Floats, Floats]


def sights_of(camera: AnyCamera, x: Floats, y: Floats) -> Sights:
    """Compute what pixels see.

    Shapes: ``x, y`` (...), returns (...) three times.
    """
    if isinstance(camera, PinholeCamera) and camera.k1 == 0.0:
        return x, y, np.ones_like(x)
    rays = camera.rays(np.stack([x, y], axis=-1))
    if isinstance(camera, LensCamera):
        return rays[..., 0], rays[..., 1], rays[..., 2]
    return camera.fx * rays[..., 0] + camera.cx, camera.fy * rays[..., 1] + camera.cy, np.ones_like(x)


@lru_cache(maxsize=4)
def all_sights(camera: AnyCamera, per_pixel: int) -> Sights:
    """Compute what a grid of samples sees, (H, W) three times.

    * ``per_pixel``: 1: the centres of the pixels; 2: two rows and two columns of samples in each pixel.
    """
    first = 0.5 / per_pixel - 0.5
    x, y = (first + np.arange(per_pixel * side) / per_pixel for side in (camera.width, camera.height))
    u, v, w = sights_of(camera, *np.broadcast_arrays(x[None], y[:, None]))
    return u, v, np.broadcast_to(w[:1, :1], u.shape) if isinstance(camera, PinholeCamera) else w
