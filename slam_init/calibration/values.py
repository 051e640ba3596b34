"""Checked values of a calibration file. Error messages name the key; the caller adds the name of the file."""

from __future__ import annotations

import math
from collections.abc import Mapping

from slam_init.errors import CalibrationError

#: Width and height in pixels, where they are known.
Size = tuple[int, int] | None
#: The keys and values of a file. A value is checked when it is read.
Content = Mapping[str, object]


def number_of(content: Content, key: str, default: float | None = None) -> float:
    """Read a finite number. Text that holds a number is accepted, since YAML 1.1 reads ``1e-5`` as text."""
    if content.get(key) is None:
        if default is not None and key not in content:
            return default
        raise CalibrationError(f"{key} is missing: give a number")
    value = content[key]
    try:
        number = float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else math.nan
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise CalibrationError(f"{key} is {str(value)[:40]!r}: give a number")
    return number


def numbers_of(content: Content, key: str, default: list[float] | None = None) -> list[float]:
    """Read a list of finite numbers: flat, nested by rows, or under ``data`` as in files of OpenCV."""
    value = content.get(key)
    if isinstance(value, dict):
        value = value.get("data")
    if value is None and default is not None:
        return default
    if not isinstance(value, list):
        raise CalibrationError(f"{key} is {str(value)[:40]!r}: give a list of numbers")
    flat = [item for row in value for item in (row if isinstance(row, list) else [row])]
    return [number_of({key: item}, key) for item in flat]


def integer_size(content: Content, width_key: str, height_key: str, image_size: Size) -> tuple[int, int]:
    """Read width and height, or take those of the images if the file has none."""
    if width_key not in content and height_key not in content and image_size is not None:
        return image_size
    sides = number_of(content, width_key), number_of(content, height_key)
    if any(side != round(side) for side in sides):
        raise CalibrationError(f"image size {sides[0]}x{sides[1]}: give whole pixels")
    return round(sides[0]), round(sides[1])


def mapping_of(content: Content, key: str, what: str) -> Content:
    """Read a mapping."""
    value = content.get(key)
    if not isinstance(value, dict):
        raise CalibrationError(f"{key} is {'missing' if value is None else 'no mapping'}: expected {what} in it")
    return value
