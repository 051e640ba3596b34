"""The camera model, which maps pixels to bearings and points to pixels.

There are three models:

* ``pinhole``: no distortion;
* ``radtan``: OpenCV's radial-tangential model ``k1, k2, p1, p2[, k3]`` (COLMAP: OPENCV, FULL_OPENCV);
* ``fisheye``: OpenCV's equidistant model ``k1, k2, k3, k4`` (COLMAP: OPENCV_FISHEYE, Kalibr: equidistant).

Pixels are converted to unit bearings once; all later stages work on bearings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from slam_init.errors import CalibrationError
from slam_init.types.arrays import Floats
from slam_init.types.display import Described

__all__ = ["Camera"]

# Newton's method doubles the number of correct digits in each step. Real lenses need 4 to 8 steps; pixels near the
# radius at which the lens polynomial stops growing need more.
_NEWTON_STEPS = 30
# Largest residual on the plane z = 1 of an undistorted pixel: 1e-7 px for a focal length of 1000 px.
_SOLVED = 1e-10
# Rays are represented on the plane z = 1, which ends at 90 degrees.
_MAX_FISHEYE_ANGLE_RAD = math.radians(89.0)

# Range of the focal length in units of the longer side: a fisheye of 180 degrees has 0.3, a telescope 100. A value
# outside is in a wrong unit (metres, a fraction of the width), and later numbers would overflow.
_FOCAL_RANGE = (0.01, 1000.0)
# Largest distance of the principal point from the centre, in units of the longer side: cropping moves it by less.
_MAX_OFFSET = 10.0
# Largest ratio of fx and fy. Anamorphic lenses have 2; a larger ratio is a wrong decimal point.
_MAX_ASPECT = 5.0
# Largest distortion coefficient. That of a telescope, whose rays have a tangent of 0.01, may reach thousands.
_MAX_DISTORTION = 1e6
# Longest side of an image in pixels: a million is more than any decoder takes.
_MAX_SIDE = 1_000_000

# Longest readout of a rolling shutter: no frame takes longer than its interval, and no video is slower than this.
_MAX_READOUT_MS = 1000.0
# Unit vectors of the directions in which an image is read out.
_READOUT_DIRECTIONS = {"down": (0.0, 1.0), "up": (0.0, -1.0), "right": (1.0, 0.0), "left": (-1.0, 0.0)}

#: Where a focal length may be from.
_SOURCES = ("stated", "file", "metadata", "prior", "estimated")
#: Of the logarithm of the focal length: from a fisheye to a telescope. More is no knowledge.
_MAX_FOCAL_SIGMA = 1.0

# Allowed numbers of distortion coefficients.
_DISTORTION_SIZES = {"pinhole": (0,), "radtan": (4, 5), "fisheye": (4,)}


@dataclass(frozen=True)
class Camera(Described):
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
    source : str
        Where the focal length is from: ``stated`` (by the user, or a calibration in code), ``file``, ``metadata`` of
        the images, ``prior`` (nothing is known but what lenses have) or ``estimated`` from the motion.
    focal_sigma : float or None
        Relative standard deviation of the focal length; None for a calibration, which is better than two per cent.
    readout_ms : float or None
        Time from the first to the last row of a rolling shutter; 0 for a global shutter, None if unknown. Poses and
        time stamps are those of the middle row.
    readout_direction : str
        ``down``, ``up``, ``right`` or ``left``: in which direction of the image rows, or columns, are read.

    Raises
    ------
    CalibrationError
        If the model or the direction is unknown, if a focal length or a size is not positive, or if a number is not
        finite or outside of the range of real cameras.
    """

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    source: str = field(default="stated", compare=False)
    focal_sigma: float | None = None
    readout_ms: float | None = None
    readout_direction: str = "down"

    def __post_init__(self) -> None:
        if self.model not in _DISTORTION_SIZES:
            raise CalibrationError(f"unknown camera model {self.model!r}: use one of {', '.join(_DISTORTION_SIZES)}")
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
        if max(self.width, self.height) > _MAX_SIDE:
            raise CalibrationError(f"the image size has more than {_MAX_SIDE} pixels a side: give that of the images")
        self._check_plausible()
        if len(self.distortion) not in _DISTORTION_SIZES[self.model]:
            allowed = " or ".join(str(n) for n in _DISTORTION_SIZES[self.model])
            raise CalibrationError(
                f"{len(self.distortion)} distortion coefficients for a {self.model} camera: give {allowed}"
            )
        if not all(abs(k) <= _MAX_DISTORTION for k in self.distortion):
            raise CalibrationError(
                f"distortion {list(self.distortion)} holds a number that is not finite, or larger than that of any lens"
            )
        if self.source not in _SOURCES:
            raise CalibrationError(f"unknown source {self.source!r} of a camera: use one of {', '.join(_SOURCES)}")
        if self.focal_sigma is not None and not 0 < self.focal_sigma <= _MAX_FOCAL_SIGMA:
            raise CalibrationError(
                f"focal_sigma is {self.focal_sigma!r}: give the relative standard deviation, up to {_MAX_FOCAL_SIGMA:g}"
            )
        if self.readout_ms is not None and not 0 <= self.readout_ms <= _MAX_READOUT_MS:
            raise CalibrationError(
                f"readout is {self.readout_ms!r} ms: give milliseconds from 0 to {_MAX_READOUT_MS:g}, and for rows "
                "that are read upwards the direction 'up'"
            )
        if self.readout_direction not in _READOUT_DIRECTIONS:
            raise CalibrationError(
                f"unknown readout direction {self.readout_direction!r}: use one of {', '.join(_READOUT_DIRECTIONS)}"
            )

    def _check_plausible(self) -> None:
        side = max(self.width, self.height)
        for name in ("fx", "fy"):
            if not _FOCAL_RANGE[0] * side <= getattr(self, name) <= _FOCAL_RANGE[1] * side:
                raise CalibrationError(
                    f"focal length {name} is {getattr(self, name)!r} for {self.width}x{self.height} images: give pixels"
                )
        if not 1 / _MAX_ASPECT <= self.fx / self.fy <= _MAX_ASPECT:
            raise CalibrationError(f"focal lengths fx = {self.fx!r}, fy = {self.fy!r} are too different: correct one")
        for name, length in (("cx", self.width), ("cy", self.height)):
            if abs(getattr(self, name) - length / 2) > _MAX_OFFSET * side:
                raise CalibrationError(
                    f"principal point {name} is {getattr(self, name)!r} for {self.width}x{self.height} images: "
                    "give pixels"
                )

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)

    @property
    def focal_px(self) -> float:
        """Geometric mean of fx and fy: the number of pixels per radian near the centre."""
        return math.sqrt(self.fx * self.fy)

    @property
    def focal_sigma_px(self) -> float | None:
        """Standard deviation of the focal length in pixels; None for a calibration.

        Returns
        -------
        float or None
        """
        return None if self.focal_sigma is None else self.focal_sigma * self.focal_px

    @property
    def readout_s(self) -> float | None:
        """Time from the first to the last row of a rolling shutter in seconds; None if unknown.

        Returns
        -------
        float or None
        """
        return None if self.readout_ms is None else 1e-3 * self.readout_ms

    @property
    def readout_axis(self) -> tuple[float, float]:
        """Unit vector of the direction in which the image is read out.

        Where the readout is unknown, sensors are taken to be read along their shorter side. An upright image comes from
        a phone that is held upright, whose columns are read one after the other.

        Returns
        -------
        (float, float)
        """
        if self.readout_ms is None and self.height > self.width:
            return _READOUT_DIRECTIONS["right"]
        return _READOUT_DIRECTIONS[self.readout_direction]

    def with_readout(self, seconds: float) -> Camera:
        """The same camera with an estimated readout.

        Parameters
        ----------
        seconds : float
            Along :attr:`readout_axis`; a negative readout has the opposite direction.

        Returns
        -------
        Camera
        """
        sign = math.copysign(1.0, seconds)
        axis = tuple(sign * component for component in self.readout_axis)
        direction = next(name for name, vector in _READOUT_DIRECTIONS.items() if vector == axis)
        return replace(self, readout_ms=1e3 * abs(seconds), readout_direction=direction)

    def refocused(self, log_scale: float, k1: float = 0.0) -> Camera:
        """The same camera with another focal length, and more radial distortion.

        Parameters
        ----------
        log_scale : float
            Logarithm of the new focal length over this one.
        k1 : float
            Added to the first coefficient of the radial distortion.

        Returns
        -------
        Camera
        """
        factor = math.exp(log_scale)
        return replace(self, fx=self.fx * factor, fy=self.fy * factor).bent(k1)

    def bent(self, k1: float) -> Camera:
        """The same camera with more radial distortion.

        Parameters
        ----------
        k1 : float
            Added to the first coefficient of the radial distortion.

        Returns
        -------
        Camera
        """
        if k1 == 0.0:
            return self
        if self.model == "pinhole":
            return replace(self, model="radtan", distortion=(k1, 0.0, 0.0, 0.0))
        first, *others = self.distortion or (0.0, 0.0, 0.0, 0.0)
        return replace(self, distortion=(first + k1, *others))

    @property
    def is_distorted(self) -> bool:
        """True if raw pixels differ from those of a pinhole camera."""
        return self.model == "fisheye" or any(k != 0 for k in self.distortion)

    def scaled(self, factor: float) -> Camera:
        """Compute the calibration of the same camera for resized images.

        Parameters
        ----------
        factor : float
            Size of the new images over that of the old ones.

        Returns
        -------
        Camera
        """
        return replace(
            self,
            width=max(1, round(self.width * factor)),
            height=max(1, round(self.height * factor)),
            fx=self.fx * factor,
            fy=self.fy * factor,
            cx=(self.cx + 0.5) * factor - 0.5,
            cy=(self.cy + 0.5) * factor - 0.5,
        )

    def normalize(self, pixels: Floats) -> Floats:
        """Undistort raw pixels to the plane z = 1.

        The distortion is inverted by Newton's method to machine precision. The fixed-point iteration of OpenCV has an
        error of 0.1 px in the corners of a strongly distorting lens.

        Parameters
        ----------
        pixels : (N, 2) float
            Raw pixels.

        Returns
        -------
        (N, 2) float
            NaN for pixels without a ray: beyond the radius at which the lens polynomial stops growing, and for fisheye
            cameras beyond 89 degrees from the optical axis.
        """
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        centred = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.model == "fisheye":
            return _undistort_fisheye(centred, self.distortion)
        return _undistort_radtan(centred, self.distortion) if self.is_distorted else centred

    def bearings(self, pixels: Floats) -> Floats:
        """Compute the bearings of raw pixels.

        Parameters
        ----------
        pixels : (N, 2) float
            Raw pixels.

        Returns
        -------
        (N, 3) float
            Unit rays in the camera frame; NaN where :meth:`normalize` gives NaN.
        """
        xy = self.normalize(pixels)
        rays = np.column_stack([xy, np.ones(len(xy))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(self, points: Floats) -> Floats:
        """Project points to raw pixels.

        Parameters
        ----------
        points : (N, 3) float
            In the camera frame.

        Returns
        -------
        (N, 2) float
            NaN for points that the lens does not see: those not in front of the camera, and those beyond the radius at
            which the lens polynomial stops growing. The polynomial would map the latter into the image.
        """
        points = np.asarray(points, float).reshape(-1, 3)
        in_front = points[:, 2] > 0
        xy = points[:, :2] / np.where(in_front, points[:, 2], 1.0)[:, None]
        seen = in_front
        if self.model == "fisheye":
            angle = np.arctan(np.hypot(xy[:, 0], xy[:, 1]))
            seen = in_front & (angle < _turning_radius(self.distortion, _MAX_FISHEYE_ANGLE_RAD))
            xy = _distort_fisheye(xy, self.distortion)
        elif self.is_distorted:
            seen = in_front & (np.hypot(xy[:, 0], xy[:, 1]) < _turning_radius(_radial(self.distortion), np.inf))
            xy = _distort_radtan(xy, self.distortion)
        pixels = xy * (self.fx, self.fy) + (self.cx, self.cy)
        pixels[~seen] = np.nan
        return np.asarray(pixels)

    @property
    def max_tangent(self) -> float:
        """Tangent of the largest angle from the optical axis that the lens sees; infinite where nothing limits it."""
        if self.model == "fisheye":
            return math.tan(_turning_radius(self.distortion, _MAX_FISHEYE_ANGLE_RAD))
        return _turning_radius(_radial(self.distortion), np.inf) if self.is_distorted else math.inf

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        known = (
            "" if self.focal_sigma is None else f" (focal length by {self.source}, +- {100 * self.focal_sigma:.2g} %)"
        )
        facts = [
            ("focal", f"{self.fx:.6g}, {self.fy:.6g} px"),
            ("principal", f"{self.cx:.6g}, {self.cy:.6g} px"),
        ]
        if self.distortion:
            facts.append(("distortion", ", ".join(f"{k:.4g}" for k in self.distortion)))
        if self.readout_ms is not None:
            facts.append(("readout", f"{self.readout_ms:.4g} ms, {self.readout_direction}"))
        return f"{self.model} camera, {self.width}x{self.height}{known}", facts


def _radial(distortion: tuple[float, ...]) -> tuple[float, ...]:
    """``k1, k2[, k3]`` of radtan coefficients."""
    return (*distortion[:2], *distortion[4:])


def _polynomial(k: tuple[float, ...], r: Floats) -> tuple[Floats, Floats]:
    """Value and derivative of ``r (1 + k1 r^2 + k2 r^4 + ...)``."""
    value, slope = np.ones_like(r), np.ones_like(r)
    for i, ki in enumerate(k, start=1):
        power = r ** (2 * i)
        value = value + ki * power
        slope = slope + (2 * i + 1) * ki * power
    return r * value, slope


def _turning_radius(k: tuple[float, ...], limit: float) -> float:
    """Radius at which ``r (1 + k1 r^2 + ...)`` stops growing, at most ``limit``."""
    # The slope is a polynomial in s = r^2. At its smallest positive root the distorted radius stops growing.
    # A coefficient below 1e-100 moves nothing, and a division by it overflows.
    coefficients = [(2 * i + 1) * ki if abs(ki) > 1e-100 else 0.0 for i, ki in enumerate(k, start=1)]
    roots = np.roots([*reversed(coefficients), 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return min(limit, float(np.sqrt(real.min()))) if len(real) else limit


def _distort_radtan(xy: Floats, distortion: tuple[float, ...]) -> Floats:
    """Distorted coordinates on the plane z = 1 of ideal ones (N, 2), for OpenCV's ``k1, k2, p1, p2[, k3]``."""
    k1, k2, p1, p2, k3 = (*distortion, 0.0)[:5]
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def _undistort_radtan(distorted: Floats, distortion: tuple[float, ...]) -> Floats:
    """Inverse of :func:`_distort_radtan`; NaN where it does not exist.

    Newton's method starts from the distorted point. For the radial part alone it converges monotonically, for barrel
    and for pincushion lenses (the profile is concave or convex). The tangential part is small.
    """
    k1, k2, p1, p2, k3 = (*distortion, 0.0)[:5]
    xy = distorted.copy()
    with np.errstate(all="ignore"):  # points without a ray may overflow; they end as NaN
        for _ in range(_NEWTON_STEPS):
            x, y = xy[:, 0], xy[:, 1]
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            radial_slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d r2, times 2
            residual = _distort_radtan(xy, distortion) - distorted
            jxx = radial + x * x * radial_slope + 2 * p1 * y + 6 * p2 * x
            jxy = x * y * radial_slope + 2 * p1 * x + 2 * p2 * y
            jyy = radial + y * y * radial_slope + 6 * p1 * y + 2 * p2 * x
            determinant = jxx * jyy - jxy * jxy
            step = np.column_stack(
                [
                    (jyy * residual[:, 0] - jxy * residual[:, 1]) / determinant,
                    (jxx * residual[:, 1] - jxy * residual[:, 0]) / determinant,
                ]
            )
            xy = xy - step
            if np.all(np.abs(step) < 1e-13):
                break
        residual = _distort_radtan(xy, distortion) - distorted
        solved = np.abs(residual).max(axis=1, initial=0.0) < _SOLVED
        # A root beyond the turning radius is another ray, which the lens polynomial maps to the same pixel.
        seen = np.hypot(xy[:, 0], xy[:, 1]) < _turning_radius(_radial(distortion), np.inf)
    xy[~(solved & seen)] = np.nan
    return xy


def _distort_fisheye(xy: Floats, distortion: tuple[float, ...]) -> Floats:
    """Distorted coordinates on the plane z = 1 of ideal ones (N, 2): their radius is a polynomial of the angle."""
    radius = np.hypot(xy[:, 0], xy[:, 1])
    distorted, _ = _polynomial(distortion, np.arctan(radius))
    return np.asarray(xy * np.where(radius > 1e-12, distorted / np.maximum(radius, 1e-12), 1.0)[:, None])


def _undistort_fisheye(distorted: Floats, distortion: tuple[float, ...]) -> Floats:
    """Inverse of :func:`_distort_fisheye`; NaN where it does not exist."""
    radius = np.hypot(distorted[:, 0], distorted[:, 1])
    limit = _turning_radius(distortion, _MAX_FISHEYE_ANGLE_RAD)
    angle = np.minimum(radius, limit)
    with np.errstate(all="ignore"):  # points without a ray end as NaN
        for _ in range(_NEWTON_STEPS):
            value, slope = _polynomial(distortion, angle)
            angle = np.clip(angle - (value - radius) / slope, 0.0, limit)
        value, _ = _polynomial(distortion, angle)
        solved = (np.abs(value - radius) < _SOLVED) & (angle < limit)
        scale = np.where(radius > 1e-12, np.tan(angle) / np.maximum(radius, 1e-12), 1.0)
    return np.where(solved[:, None], distorted * scale[:, None], np.nan)
