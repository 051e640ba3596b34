"""The camera: what a pixel means.

Three models, told apart by ``model``:

* ``pinhole``: no distortion;
* ``radtan``: OpenCV's radial-tangential model ``k1, k2, p1, p2[, k3]`` (COLMAP: OPENCV, FULL_OPENCV);
* ``fisheye``: OpenCV's equidistant model ``k1, k2, k3, k4`` (COLMAP: OPENCV_FISHEYE, Kalibr: equidistant).

Pixels are undistorted once, into unit bearings; everything after works on bearings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from slam_init.errors import CalibrationError
from slam_init.types import Floats

__all__ = ["Camera"]

_DISTORTION_SIZES = {"pinhole": (0,), "radtan": (4, 5), "fisheye": (4,)}


@dataclass(frozen=True)
class Camera:
    """Intrinsic calibration of one camera.

    Attributes
    ----------
    model : str
        ``pinhole``, ``radtan`` or ``fisheye``.
    width, height : int
        Image size in pixels.
    fx, fy, cx, cy : float
        Focal lengths and principal point in pixels; pixel centres at integer coordinates.
    distortion : tuple of float
        ``()``, ``(k1, k2, p1, p2[, k3])`` or ``(k1, k2, k3, k4)``.
    guessed : bool
        True where the focal length is a guess, not a calibration.

    Raises
    ------
    CalibrationError
        Where a number is not finite, a focal length not positive, a size not positive, a model unknown.
    """

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    guessed: bool = False

    def __post_init__(self) -> None:
        if self.model not in _DISTORTION_SIZES:
            raise CalibrationError(
                f"unknown camera model {self.model!r}: use one of {', '.join(_DISTORTION_SIZES)}"
            )
        for name in ("fx", "fy"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise CalibrationError(f"focal length {name} is {value!r}: it must be a positive number of pixels")
        for name in ("cx", "cy"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise CalibrationError(f"principal point {name} is {value!r}: it must be a finite number of pixels")
        if self.width <= 0 or self.height <= 0:
            raise CalibrationError(f"image size {self.width}x{self.height}: both sides must be positive")
        if len(self.distortion) not in _DISTORTION_SIZES[self.model]:
            allowed = " or ".join(str(n) for n in _DISTORTION_SIZES[self.model])
            raise CalibrationError(
                f"{len(self.distortion)} distortion coefficients for a {self.model} camera: give {allowed}"
            )
        if not all(math.isfinite(k) for k in self.distortion):
            raise CalibrationError(f"distortion {list(self.distortion)} holds a number that is not finite")

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)

    @property
    def focal_px(self) -> float:
        """Geometric mean of the focal lengths: turns pixels into radians near the centre."""
        return math.sqrt(self.fx * self.fy)

    @property
    def is_distorted(self) -> bool:
        """True where raw pixels differ from those of a pinhole camera."""
        return self.model == "fisheye" or any(k != 0 for k in self.distortion)

    def scaled(self, factor: float) -> Camera:
        """The same camera for images resized by ``factor`` (pixel centres at integers)."""
        return replace(
            self,
            width=round(self.width * factor),
            height=round(self.height * factor),
            fx=self.fx * factor,
            fy=self.fy * factor,
            cx=(self.cx + 0.5) * factor - 0.5,
            cy=(self.cy + 0.5) * factor - 0.5,
        )

    def normalize(self, pixels: Floats) -> Floats:
        """Undistort raw pixels (N, 2) to the plane z = 1 (N, 2)."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        centred = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        if not self.is_distorted or len(pixels) == 0:
            return centred
        import cv2

        points, coefficients = pixels[:, None], np.asarray(self.distortion)
        if self.model == "fisheye":
            return np.asarray(cv2.fisheye.undistortPoints(points, self.K, coefficients)[:, 0], float)
        # OpenCV's default of five fixed-point steps leaves 0.1 px at the corner of a strong lens.
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        undistorted = cv2.undistortPointsIter(points, self.K, coefficients, None, None, criteria)  # type: ignore[call-overload]
        return np.asarray(undistorted[:, 0], float)

    def bearings(self, pixels: Floats) -> Floats:
        """Unit rays (N, 3) of raw pixels (N, 2), in the camera frame."""
        xy = self.normalize(pixels)
        rays = np.column_stack([xy, np.ones(len(xy))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(self, points: Floats) -> Floats:
        """Raw pixels (N, 2) of points (N, 3) in the camera frame; NaN for points not in front."""
        points = np.asarray(points, float).reshape(-1, 3)
        in_front = points[:, 2] > 0
        z = np.where(in_front, points[:, 2], 1.0)
        x, y = points[:, 0] / z, points[:, 1] / z
        if self.model == "fisheye":
            r = np.hypot(x, y)
            theta = np.arctan(r)
            k1, k2, k3, k4 = self.distortion
            t2 = theta * theta
            theta_d = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            scale = np.where(r > 1e-12, theta_d / np.maximum(r, 1e-12), 1.0)
            x, y = x * scale, y * scale
        elif self.model == "radtan":
            k1, k2, p1, p2, k3 = (*self.distortion, 0.0)[:5]
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            )
        pixels = np.column_stack([self.fx * x + self.cx, self.fy * y + self.cy])
        pixels[~in_front] = np.nan
        return np.asarray(pixels)
