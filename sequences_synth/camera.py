"""The camera of the synthetic worlds: a pinhole, or one of two lenses; and its shutter.

The lenses are written from the papers of the models. Each has usual parameters, and a field of view beyond which its
image is black. The formulas project; a ray of a pixel is found by Newton's method. Coefficients are in the order of
OpenCV.

===========  ==================================================================================
``radtan``   k1 k2 p1 p2: OpenCV
``fisheye``  k1 k2 k3 k4: Kannala and Brandt, PAMI 2006, with odd powers of the angle only
===========  ==================================================================================

A rolling shutter exposes the rows or columns of an image one after the other. A pixel (x, y) is exposed at ::

    t_frame + readout * (y / height - 1/2)      direction "down"
    t_frame - readout * (y / height - 1/2)      direction "up"
    t_frame + readout * (x / width  - 1/2)      direction "right"
    t_frame - readout * (x / width  - 1/2)      direction "left"

The time stamp and the true pose of a frame are those of its middle row or column. A readout of 0 is a global shutter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sequences_synth.arrays import Floats

# Usual parameters: focal length over the width of the image, coefficients, largest angle from the axis (deg).
_USUAL = {"radtan": (0.61, (-0.283, 0.074, 1.9e-4, 1.8e-5), 60.0), "fisheye": (0.3, (0.02, -0.01, 3e-3, -1e-3), 100.0)}
#: The names of the lenses.
LENSES = tuple(_USUAL)

# The angle of a pixel is read from a table of this many radii, then improved by Newton's method with the derivatives at
# the start. The table is exact to 1e-6 rad for radial models; other terms move a ray by a hundredth, and each step
# divides the error by a hundred or more. It ends at this error in pixels.
_TABLE, _NEWTON_STEPS, _EXACT_PX = 2000, 10, 1e-9
# Half of the step of the derivatives of Newton's method, rad.
_STEP_RAD = 1e-6


@dataclass(frozen=True)
class SynthCamera:
    """A camera; all values in pixels, pixel centres at integer coordinates."""

    #: width, height: Image size.
    width: int
    height: int
    #: fx, fy, cx, cy: Factors of the lens coordinates, and principal point.
    fx: float
    fy: float
    cx: float
    cy: float
    #: ``pinhole``, or one of :data:`LENSES`.
    model: str = "pinhole"
    #: See the module docstring.
    coefficients: tuple[float, ...] = ()
    #: Largest angle between the optical axis and a ray that is seen. That of a pinhole lies outside of every image.
    half_field_rad: float = math.radians(89.0)

    @property
    def is_pinhole(self) -> bool:
        """Whether the image is a plane one."""
        return self.model == "pinhole"

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    def project(self, points: Floats) -> Floats:
        """Project points; for a pinhole they are before the camera.

        Shapes: ``points`` (..., 3), returns (..., 2).
        """
        if self.is_pinhole:
            focal, centre = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
            return np.asarray(focal * points[..., :2] / points[..., 2:] + centre)
        X, Y, Z = np.moveaxis(np.asarray(points, float), -1, 0)
        with np.errstate(all="ignore"):  # outside of the field of view
            u, v = _FORMULAS[self.model](X, Y, Z, self.coefficients)
        return np.stack([self.fx * u + self.cx, self.fy * v + self.cy], axis=-1)

    def rays(self, pixels: Floats) -> Floats:
        """Compute the rays of pixels.

        Shapes: ``pixels`` (..., 2), returns (..., 3).

        * Returns: In the frame of the camera: of a pinhole with z = 1; of a lens of length 1, and 0 outside of its
          field of view.
        """
        seen = (np.asarray(pixels, float) - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.is_pinhole:
            return np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1)
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
                x = b[..., 1] * error[..., 0] - b[..., 0] * error[..., 1]
                y = a[..., 0] * error[..., 1] - a[..., 1] * error[..., 0]
                change = np.stack([x, y], axis=-1) / determinant[..., None]
            # Outside of the field of view the formula may be flat; the place stays finite.
            place = place - np.clip(np.nan_to_num(change), -0.1, 0.1)
        inside = np.linalg.norm(place, axis=-1) <= self.half_field_rad
        inside &= np.linalg.norm(np.nan_to_num(self.project(_ray(place)) - pixels, nan=1e9), axis=-1) < 1e-6
        return np.where(inside[..., None], _ray(place), 0.0)

    def bent(self, k1: float) -> SynthCamera:
        """Return a pinhole with a radial distortion, seen up to where a negative one has its largest radius."""
        if k1 == 0.0:
            return self
        half_field_rad = math.atan(math.sqrt(-1 / (3 * k1))) if k1 < 0 else self.half_field_rad
        return replace(self, model="radtan", coefficients=(k1, 0.0, 0.0, 0.0), half_field_rad=half_field_rad)


def lens_camera(model: str, width: int, height: int) -> SynthCamera:
    """Make a camera with the usual parameters of a model."""
    focal, coefficients, half_field_deg = _USUAL[model]
    fx, cx, cy = focal * width, (width - 1) / 2, (height - 1) / 2
    return SynthCamera(width, height, fx, fx, cx, cy, model, coefficients, math.radians(half_field_deg))


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


def stated_camera(
    ideal: SynthCamera, focal_error: float, principal_error: float, rng: np.random.Generator
) -> SynthCamera:
    """Make the camera that the data state, which may have wrong values.

    * ``ideal``: The true camera, without the distortion that the data do not state.
    * ``focal_error``: The stated focal length is the true one times ``1 + focal_error``.
    * ``principal_error``: Horizontal error of the principal point over the width, and vertical error over the height.
    """
    right, down = rng.choice([-1.0, 1.0], 2).tolist()
    return replace(
        ideal,
        fx=ideal.fx * (1 + focal_error),
        fy=ideal.fy * (1 + focal_error),
        cx=ideal.cx + right * principal_error * ideal.width,
        cy=ideal.cy + down * principal_error * ideal.height,
    )


#: What a pixel sees, three coordinates: of a lens its ray, of a pinhole (x, y, 1).
Sights = tuple[Floats, Floats, Floats]


def sights_of(camera: SynthCamera, x: Floats, y: Floats) -> Sights:
    """Compute what pixels see.

    Shapes: ``x, y`` (...), returns (...) three times.
    """
    if camera.is_pinhole:
        return x, y, np.ones_like(x)
    rays = camera.rays(np.stack([x, y], axis=-1))
    return rays[..., 0], rays[..., 1], rays[..., 2]


@lru_cache(maxsize=4)
def all_sights(camera: SynthCamera, per_pixel: int) -> Sights:
    """Compute what a grid of samples sees, (H, W) three times.

    * ``per_pixel``: 1: the centres of the pixels; 2: two rows and two columns of samples in each pixel.
    """
    first = 0.5 / per_pixel - 0.5
    x, y = (first + np.arange(per_pixel * side) / per_pixel for side in (camera.width, camera.height))
    u, v, w = sights_of(camera, *np.broadcast_arrays(x[None], y[:, None]))
    return u, v, np.broadcast_to(w[:1, :1], u.shape) if camera.is_pinhole else w


# -- the shutter -----------------------------------------------------------------------------------


#: The directions in which the rows or columns are read.
READOUT_DIRECTIONS: tuple[str, ...] = ("down", "up", "right", "left")
# Those in which columns are read one after the other, and not rows.
_BY_COLUMNS = ("right", "left")


@dataclass(frozen=True)
class Shutter:
    """A rolling shutter."""

    #: Time from the first to the last row or column; 0 for a global shutter.
    readout_s: float
    #: One of :data:`READOUT_DIRECTIONS`.
    direction: str
    #: width, height: Image size in pixels.
    width: int
    height: int

    def row_delay_s(self, row: Floats) -> Floats:
        """Compute the exposure times of rows, or of columns where these are read."""
        sign = -1.0 if self.direction in ("up", "left") else 1.0
        lines = self.width if self.direction in _BY_COLUMNS else self.height
        return np.asarray(sign * self.readout_s * (row / lines - 0.5))

    def delay_s(self, pixels: Floats) -> Floats:
        """Compute the exposure times of pixels.

        Shapes: ``pixels`` (..., 2).
        """
        return self.row_delay_s(pixels[..., 0 if self.direction in _BY_COLUMNS else 1])
