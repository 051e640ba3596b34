"""Checked values of one camera in a file. Error messages name the key as the file has it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TypeAlias

from slam_init.errors import CalibrationError

#: Width and height in pixels, where they are known.
Size: TypeAlias = tuple[int, int] | None
#: The keys and values of a file. A value is checked when it is read.
Content: TypeAlias = Mapping[str, object]

# ORB-SLAM, openvslam and stella_vslam write this before the keys of a camera.
_PREFIX = re.compile(r"camera1?\.", re.IGNORECASE)
_SIDES = tuple(re.compile(rf"(?:(?:image|img|im|frame)_?)?(?:{names})") for names in ("width|cols", "height|rows"))
_PAIRS = ("resolution", "image_size", "img_size")


@contextmanager
def at_place(place: object) -> Iterator[None]:
    """Put a file, or a place in it, before the message of an impossible calibration."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"{place}: {error}") from None


class Section:
    """The values of one camera by plain names: lower case, without ``Camera.``, ``_`` for spaces and hyphens.

    Formats spell the same key in many ways. A key whose value is null counts as absent.
    """

    def __init__(self, content: Content) -> None:
        self.values: dict[str, object] = {}
        self._keys: dict[str, str] = {}
        self._prefix = ""
        for key, value in ((str(key), value) for key, value in content.items()):
            found = _PREFIX.match(key)
            self._prefix = found[0] if found else self._prefix
            name = re.sub(r"[ -]", "_", _PREFIX.sub("", key, count=1).lower())
            # The keys of Camera1 are those of the first camera, and those of Camera are common to all.
            if value is not None and (name not in self.values or key.startswith("Camera1.")):
                self.values[name], self._keys[name] = value, key

    def key(self, name: str) -> str:
        """The key of a name as the file has it, or would have it."""
        return self._keys.get(name, self._prefix + name)

    def first(self, *names: str) -> str | None:
        """The first of some names that is present."""
        return next((name for name in names if name in self.values), None)

    def number(self, name: str, default: float | None = None) -> float:
        """Read a finite number. Text that holds a number is accepted, since YAML 1.1 reads ``1e-5`` as text."""
        if name not in self.values:
            if default is not None:
                return default
            raise CalibrationError(f"{self.key(name)} is missing: give a number")
        return _number(self.key(name), self.values[name])

    def numbers(self, name: str) -> list[float]:
        """Read a list of finite numbers: flat, nested by rows, or under ``data`` as in files of OpenCV."""
        value = self.values[name]
        if isinstance(value, dict):
            value = value.get("data")
        if not isinstance(value, list):
            raise CalibrationError(f"{self.key(name)} is {str(value)[:40]!r}: give a list of numbers")
        flat = [item for row in value for item in (row if isinstance(row, list) else [row])]
        return [_number(self.key(name), item) for item in flat]

    @property
    def states_size(self) -> bool:
        """Whether the file states the size of its images."""
        return self.first(*_PAIRS) is not None or any(side.fullmatch(name) for side in _SIDES for name in self.values)

    def size(self, image_size: Size) -> tuple[int, int]:
        """Read width and height, or take those of the images if the file has none."""
        if name := self.first(*_PAIRS):
            sides = self.numbers(name)
            if len(sides) != 2:
                raise CalibrationError(f"{self.key(name)}: expected [width, height]")
        else:
            names = [self.first(*filter(side.fullmatch, self.values)) for side in _SIDES]
            if not any(names):
                if image_size is not None:
                    return image_size
                raise CalibrationError("the file states no width and height: give those of the images")
            sides = [self.number(name or side) for name, side in zip(names, ("width", "height"), strict=True)]
        if any(side != round(side) for side in sides):
            raise CalibrationError(f"image size {sides[0]}x{sides[1]}: give whole pixels")
        return round(sides[0]), round(sides[1])


def _number(key: str, value: object) -> float:
    with suppress(ValueError, OverflowError):
        if isinstance(value, int | float | str) and not isinstance(value, bool) and math.isfinite(float(value)):
            return float(value)
    raise CalibrationError(f"{key} is {str(value)[:40]!r}: give a number")
