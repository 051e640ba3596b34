"""The camera model, which maps pixels to bearings and points to pixels.

The models and their coefficients are those of :mod:`slam_init.lenses.lens`. Pixels are converted to unit
bearings once; all later stages work on bearings. Bearings may point behind the image plane.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from quest.display import Described
from slam_init.errors import CalibrationError
from slam_init.lenses.lens import (
    COEFFICIENTS,
    MAX_PLANAR_ANGLE_RAD,
    LensModel,
    bent_coefficients,
    check_coefficients,
    lens_of,
)
from slam_init.types.arrays import Floats, as_array, as_number, set_fields

if TYPE_CHECKING:
    from slam_init.lenses.points import Projection

# Range of the focal length in units of the longer side: a fisheye of 180 degrees has 0.3, a telescope 100. A value
# outside is in a wrong unit (metres, a fraction of the width), and later numbers would overflow.
_FOCAL_RANGE = (0.01, 1000.0)
# Largest distance of the principal point from the centre, in units of the longer side: cropping moves it by less.
_MAX_OFFSET = 10.0
# Largest ratio of fx and fy. Anamorphic lenses have 2; a larger ratio is a wrong decimal point.
_MAX_ASPECT = 5.0
# Shortest side of an image: two patches of a tracker.
_MIN_SIDE = 16
# Longest side of an image in pixels: a million is more than any decoder takes.
_MAX_SIDE = 1_000_000
# Largest distortion coefficient. That of a telescope, whose rays have a tangent of 0.01, may reach thousands.
_MAX_DISTORTION = 1e6

# Longest readout of a rolling shutter: no frame takes longer than its interval, and no video is slower than this.
_MAX_READOUT_MS = 1000.0
# Unit vectors of the directions in which an image is read out.
_READOUT_DIRECTIONS = {"down": (0.0, 1.0), "up": (0.0, -1.0), "right": (1.0, 0.0), "left": (-1.0, 0.0)}

#: Where a focal length may be from.
_SOURCES = ("stated", "file", "machine", "metadata", "prior", "estimated")
#: Of the logarithm of the focal length: from a fisheye to a telescope. More is no knowledge.
_MAX_FOCAL_SIGMA = 1.0

#: The models that have a number of their own in the compiled projection.
_PLANAR_MODELS = ("pinhole", "radtan", "fisheye")
# Least cosine of the angle between the optical axis and a ray that has a place on the plane z = 1.
_LEAST_DEPTH = math.cos(MAX_PLANAR_ANGLE_RAD)
# Nodes along each border of the image at which the field of view is measured.
_BORDER_NODES = 9


@dataclass(frozen=True)
class Camera(Described):
    """Intrinsic calibration of one camera.

    Attributes
    ----------
    model : str
        A name of :mod:`slam_init.lenses.lens`: ``pinhole``, ``radtan``, ``fisheye``, ``double-sphere``, ...
    width, height : int
        Image size in pixels.
    fx, fy, cx, cy : float
        Factors of the lens coordinates and principal point in pixels; pixel centres at integer coordinates. For most
        models the factors are the focal lengths; see :attr:`focal_px`.
    distortion : tuple of float
        The coefficients of the model, ``()`` or ``(k1, k2, p1, p2[, k3])`` for example.
    source : str
        Where the focal length is from: ``stated`` (by the user, or a calibration in code), ``file``, ``machine`` (the
        calibration of a robot's or a car's own camera, whose lens is fixed), ``metadata`` of the images, ``prior``
        (nothing is known but what lenses have) or ``estimated`` from the motion.
    focal_sigma : float or None
        Relative standard deviation of the focal length; None for a calibration, which is better than two per cent.
    readout_ms : float or None
        Time from the first to the last row of a rolling shutter; 0 for a global shutter, None if unknown. Poses and
        time stamps are those of the middle row.
    readout_direction : str
        ``down``, ``up``, ``right`` or ``left``: in which direction of the image rows, or columns, are read.
    notes : tuple of str
        What was left out of a calibration that this class cannot express, for the notes of a run.

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
    notes: tuple[str, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        _check_word(self.model, COEFFICIENTS, "camera model")
        _check_word(self.source, _SOURCES, "source of a camera")
        _check_word(self.readout_direction, _READOUT_DIRECTIONS, "readout direction")
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            value = as_number(getattr(self, name), f"{name} of the camera", "a number of pixels", CalibrationError)
            if name in ("width", "height"):
                if not value.is_integer():
                    raise CalibrationError(f"{name} of the camera is {value:g}: give a whole number of pixels")
                value = int(value)
            set_fields(self, **{name: value})
        _check_intrinsics(self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        set_fields(self, distortion=_as_coefficients(self.distortion))
        check_coefficients(self.model, self.distortion)
        for name, unit in (("focal_sigma", "a relative standard deviation"), ("readout_ms", "milliseconds")):
            if (given := getattr(self, name)) is not None:
                number = as_number(given, f"{name} of the camera", f"{unit}, or None", CalibrationError)
                set_fields(self, **{name: number})
        if self.focal_sigma is not None and not 0 < self.focal_sigma <= _MAX_FOCAL_SIGMA:
            raise CalibrationError(
                f"focal_sigma is {self.focal_sigma!r}: give the relative standard deviation, up to {_MAX_FOCAL_SIGMA:g}"
            )
        if self.readout_ms is not None and not 0 <= self.readout_ms <= _MAX_READOUT_MS:
            raise CalibrationError(
                f"readout is {self.readout_ms!r} ms: give milliseconds from 0 to {_MAX_READOUT_MS:g}, and for rows "
                "that are read upwards the direction 'up'"
            )

    @staticmethod
    def from_K(K: ArrayLike, size: tuple[int, int], distortion: Sequence[float] = ()) -> Camera:
        """Make a camera from a calibration matrix.

        Parameters
        ----------
        K : (3, 3) array_like
            ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` in pixels; pixel centres at integer coordinates, as in OpenCV.
        size : (int, int)
            Width and height of the images.
        distortion : sequence of float
            OpenCV's ``(k1, k2, p1, p2[, k3])``; none by default.

        Returns
        -------
        Camera

        Raises
        ------
        CalibrationError
            If this is no calibration matrix, or that of no camera.
        """
        give = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        matrix = as_array(K, np.float64, (3, 3), "K", give, CalibrationError)
        width, height = as_array(size, np.int64, (2,), "the size of the images", "(width, height)", CalibrationError)
        if not (matrix[1, 0] == matrix[0, 1] == 0 and matrix[2].tolist() == [0, 0, 1]):
            raise CalibrationError(f"K has a skew, or no last row 0 0 1: give {give}")
        (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
        coefficients = _as_coefficients(distortion)
        return Camera("radtan" if coefficients else "pinhole", width, height, fx, fy, cx, cy, coefficients)

    @property
    def lens(self) -> LensModel | None:
        """The lens, where rays may point behind the image plane or the model is no formula on the plane z = 1.

        None for ``pinhole`` and ``radtan``, and for ``fisheye`` where the image ends before 89 degrees.
        """
        return None if self._lens.is_planar else self._lens

    @cached_property
    def _lens(self) -> LensModel:
        planar = lens_of(self.model, self.distortion, is_planar=self.model in _PLANAR_MODELS)
        if self.model != "fisheye" or planar.largest_radius < MAX_PLANAR_ANGLE_RAD:
            return planar
        # Where a corner of a fisheye image is beyond 89 degrees, rays may point behind the plane.
        x, y = (
            max(centre + 0.5, length - centre) for centre, length in ((self.cx, self.width), (self.cy, self.height))
        )
        border = float(planar.bending.radial(np.array([MAX_PLANAR_ANGLE_RAD]))[0])
        return planar if math.hypot(x / self.fx, y / self.fy) <= border else lens_of(self.model, self.distortion)

    @cached_property
    def widest_rad(self) -> float:
        """Largest angle between the optical axis and the rays of the border of the image.

        Where a border has no rays, it is the largest angle that the lens sees.
        """
        x, y = np.linspace(0, self.width - 1, _BORDER_NODES), np.linspace(0, self.height - 1, _BORDER_NODES)
        columns, rows = np.meshgrid(x, y)
        border = (np.abs(columns - x.mean()) == x[-1] / 2) | (np.abs(rows - y.mean()) == y[-1] / 2)
        rays = self.bearings(np.column_stack([columns[border], rows[border]]))
        if np.isfinite(rays).all():
            return float(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]).max())
        return self._lens.max_angle_rad

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix of a camera without distortion that has the same pixels near the optical axis."""
        factor = self._lens.magnification
        return np.array([[self.fx * factor, 0, self.cx], [0, self.fy * factor, self.cy], [0, 0, 1]], float)

    @property
    def focal_px(self) -> float:
        """Geometric mean of the focal lengths: the number of pixels per radian near the centre."""
        factor = self._lens.magnification
        return math.sqrt(self.fx * factor * (self.fy * factor))

    @property
    def parameters(self) -> tuple[float, ...]:
        """fx, fy, cx, cy, then the distortion."""
        return (self.fx, self.fy, self.cx, self.cy, *self.distortion)

    @property
    def focal_sigma_px(self) -> float | None:
        """Standard deviation of the focal length in pixels; None for a calibration."""
        return None if self.focal_sigma is None else self.focal_sigma * self.focal_px

    @property
    def readout_s(self) -> float | None:
        """Time from the first to the last row of a rolling shutter in seconds; None if unknown."""
        return None if self.readout_ms is None else 1e-3 * self.readout_ms

    @property
    def readout_axis(self) -> tuple[float, float]:
        """Unit vector of the direction in which the image is read out.

        Where the readout is unknown, sensors are taken to be read along their shorter side. An upright image comes from
        a phone that is held upright, whose columns are read one after the other.
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

        * ``log_scale``: Logarithm of the new focal length over this one.
        * ``k1``: Added to the first coefficient of the radial distortion.
        """
        factor = math.exp(log_scale)
        return replace(self, fx=self.fx * factor, fy=self.fy * factor).bent(k1)

    def bent(self, k1: float) -> Camera:
        """The same camera with more radial distortion.

        * ``k1``: Added to the first coefficient of the radial distortion. For models whose lens coordinates have
          another scale, it is converted to that scale. A panorama is not bent.
        """
        if k1 == 0.0:
            return self
        if self.model == "pinhole":
            return replace(self, model="radtan", distortion=(k1, 0.0, 0.0, 0.0))
        return replace(self, distortion=bent_coefficients(self.model, self.distortion, k1))

    @property
    def is_distorted(self) -> bool:
        """True if raw pixels differ from those of a pinhole camera."""
        return self.model not in ("pinhole", "radtan") or any(k != 0 for k in self.distortion)

    def scaled(self, factor: float) -> Camera:
        """Compute the calibration of the same camera for resized images.

        * ``factor``: Size of the new images over that of the old ones.
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

        Shapes: ``pixels`` (N, 2), returns (N, 2).

        * Returns: NaN for pixels without a ray: beyond the radius at which the lens polynomial stops growing, and for
          wide lenses beyond 89 degrees from the optical axis.
        """
        if self._lens.is_perspective:
            return self._lens.undistort(self._centred(pixels))
        rays = self.bearings(pixels)
        with np.errstate(all="ignore"):  # rays behind the plane
            return np.where((rays[:, 2] >= _LEAST_DEPTH)[:, None], rays[:, :2] / rays[:, 2:], np.nan)

    def bearings(self, pixels: Floats) -> Floats:
        """Compute the bearings of raw pixels.

        Parameters
        ----------
        pixels : (N, 2) float
            Raw pixels.

        Returns
        -------
        (N, 3) float
            Unit rays in the camera frame; NaN for pixels without a ray.
        """
        return self._lens.unproject(self._centred(pixels))

    def _centred(self, pixels: Floats) -> Floats:
        """The distorted lens coordinates (N, 2) of pixels."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        return (pixels - (self.cx, self.cy)) / (self.fx, self.fy)

    def project(self, points: Floats) -> Floats:
        """Project points to raw pixels.

        Parameters
        ----------
        points : (N, 3) float
            In the camera frame.

        Returns
        -------
        (N, 2) float
            NaN for points that the lens does not see: those beyond its field of view, and those beyond the radius at
            which the lens polynomial stops growing. The polynomial would map the latter into the image.
        """
        return self.differentiated(points).pixels

    def differentiated(self, points: Floats) -> Projection:
        """Project points to raw pixels, and differentiate them.

        Shapes: ``points`` (N, 3).
        """
        from slam_init.lenses.points import projected

        return projected(self.numbers, np.asarray(points, float).reshape(-1, 3))

    def moved_pixels(self, points: Floats, moves: Floats) -> Floats:
        """How pixels move where their points move; 0 for a point that the lens does not see.

        Shapes: ``points, moves`` (N, 3), returns (N, 2).
        """
        from slam_init.lenses.points import moved

        return moved(self.numbers, points, moves)

    @cached_property
    def numbers(self) -> Floats:
        """The camera for compiled loops (:mod:`slam_init.lenses.point`).

        Shapes: returns (31,).
        """
        model = 3 if self.lens is not None else _PLANAR_MODELS.index(self.model)
        coefficients = (*self.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        first = (model, self.fx, self.fy, self.cx, self.cy, *coefficients, self.max_tangent)
        return np.array([*first, *(np.zeros(20) if self.lens is None else self.lens.numbers)])

    @property
    def max_tangent(self) -> float:
        """Tangent of the largest angle from the optical axis that the lens sees; infinite where nothing limits it."""
        if self._lens.is_planar and self._lens.is_perspective:
            return self._lens.largest_radius
        return math.tan(self._lens.max_angle_rad) if self._lens.max_angle_rad < math.pi / 2 else math.inf

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        sigma = self.focal_sigma
        known = "" if sigma is None else f" (focal length by {self.source}, +- {100 * sigma:.2g} %)"
        facts = [("focal", f"{self.fx:.6g}, {self.fy:.6g} px"), ("principal", f"{self.cx:.6g}, {self.cy:.6g} px")]
        if self.distortion:
            facts.append(("distortion", ", ".join(f"{k:.4g}" for k in self.distortion)))
        if self.readout_ms is not None:
            facts.append(("readout", f"{self.readout_ms:.4g} ms, {self.readout_direction}"))
        return f"{self.model} camera, {self.width}x{self.height}{known}", facts


def _check_word(word: object, known: Collection[str], what: str) -> None:
    if not isinstance(word, str) or word not in known:
        raise CalibrationError(f"unknown {what} {word!r:.60}: use one of {', '.join(known)}")


def _as_coefficients(distortion: object) -> tuple[float, ...]:
    """Make the coefficients of what a caller gave, or state why they are none."""
    give = "a tuple of numbers, () for none"
    coefficients = as_array(distortion, np.float64, (None,), "distortion", give, CalibrationError)
    if (np.abs(coefficients) > _MAX_DISTORTION).any():
        raise CalibrationError(f"distortion {coefficients.tolist()} holds a number larger than those of lenses")
    return tuple(coefficients.tolist())


def _check_intrinsics(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> None:
    """Refuse numbers that no camera has."""
    side = max(width, height)
    if min(width, height) < _MIN_SIDE:
        raise CalibrationError(f"image size {width}x{height}: both sides must have at least {_MIN_SIDE} pixels")
    if side > _MAX_SIDE:
        raise CalibrationError(f"the image size has more than {_MAX_SIDE} pixels a side: give that of the images")
    for name, value in (("fx", fx), ("fy", fy)):
        if value <= 0:
            raise CalibrationError(f"focal length {name} is {value!r}: it must be a positive number of pixels")
        if not _FOCAL_RANGE[0] * side <= value <= _FOCAL_RANGE[1] * side:
            raise CalibrationError(f"focal length {name} is {value!r} for {width}x{height} images: give pixels")
    if not 1 / _MAX_ASPECT <= fx / fy <= _MAX_ASPECT:
        raise CalibrationError(f"focal lengths fx = {fx!r}, fy = {fy!r} are too different: correct one")
    for name, value, length in (("cx", cx, width), ("cy", cy, height)):
        if abs(value - length / 2) > _MAX_OFFSET * side:
            raise CalibrationError(f"principal point {name} is {value!r} for {width}x{height} images: give pixels")
