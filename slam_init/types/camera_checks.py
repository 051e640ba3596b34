"""The ranges of focal lengths, principal points and sizes of real cameras."""

from __future__ import annotations

import math
from numbers import Real

from slam_init.errors import CalibrationError

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


def is_number(value: object) -> bool:
    """Whether a value is a real number, of numpy too."""
    return isinstance(value, Real) and not isinstance(value, bool)


def check_intrinsics(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> None:
    """Refuse numbers that no camera has, and what is no number."""
    given = {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    for name, value in given.items():
        if not is_number(value):
            raise CalibrationError(f"{name} of the camera is {value!r:.60}: give a number of pixels")
    for name, value in (("fx", fx), ("fy", fy)):
        if not (math.isfinite(value) and value > 0):
            raise CalibrationError(f"focal length {name} is {value!r}: it must be a positive number of pixels")
    for name, value in (("cx", cx), ("cy", cy)):
        if not math.isfinite(value):
            raise CalibrationError(f"principal point {name} is {value!r}: it must be a finite number of pixels")
    if min(width, height) < _MIN_SIDE:
        raise CalibrationError(f"image size {width}x{height}: both sides must have at least {_MIN_SIDE} pixels")
    side = max(width, height)
    if side > _MAX_SIDE:
        raise CalibrationError(f"the image size has more than {_MAX_SIDE} pixels a side: give that of the images")
    for name, value in (("fx", fx), ("fy", fy)):
        if not _FOCAL_RANGE[0] * side <= value <= _FOCAL_RANGE[1] * side:
            raise CalibrationError(f"focal length {name} is {value!r} for {width}x{height} images: give pixels")
    if not 1 / _MAX_ASPECT <= fx / fy <= _MAX_ASPECT:
        raise CalibrationError(f"focal lengths fx = {fx!r}, fy = {fy!r} are too different: correct one")
    for name, value, length in (("cx", cx, width), ("cy", cy, height)):
        if abs(value - length / 2) > _MAX_OFFSET * side:
            raise CalibrationError(f"principal point {name} is {value!r} for {width}x{height} images: give pixels")
