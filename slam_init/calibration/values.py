"""The syntaxes of calibration files, and checked values of one camera. Messages name the key as the file has it.

YAML in the dialect of OpenCV, JSON, XML, and arrays of numpy are read as mappings. Files are not trusted. YAML is read
by PyYAML's safe loader only; the tags ``!!opencv-matrix`` are read as plain mappings. Aliases, deep nesting, document
types of XML, and pickled objects are refused.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import TypeAlias
from xml.etree import ElementTree

from slam_init.errors import CalibrationError, SourceError
from slam_init.system.numpy_file import parse_npz

# -- syntax ----------------------------------------------------------------------------------------


# Deepest nesting: Kalibr's files have four levels. The time of the parser grows with the square of the depth.
_MAX_DEPTH = 20
# A matrix and coefficients have less than a kilobyte; the poses of the boards lie beside them.
_MAX_ARRAYS_BYTES = 10_000_000
_ARRAYS = (
    *("K", "k", "mtx", "camera_matrix", "cameraMatrix", "intrinsics", "intrinsic_matrix", "M1", "K1"),
    *("fx", "fy", "cx", "cy", "D", "d", "D1", "dist", "distCoeffs", "dist_coeffs", "distortion"),
    *("distortion_coefficients", "model", "distortion_model", "camera_model", "fisheye", "width", "height"),
    *("image_width", "image_height", "image_size", "resolution"),
)
# OpenCV reads a key without a space after the colon. A slash is the start of a path or an address.
_NO_SPACE = re.compile(r"^([ \t]*[A-Za-z_][\w.]*:)(?=[^\s/:])", re.MULTILINE)


def parse_yaml(text: str) -> object:
    """Read YAML, as OpenCV writes it too."""
    import yaml

    class Loader(yaml.SafeLoader):
        """The safe loader, for files of OpenCV too. A key with two values is an error, as the YAML standard says."""

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, object]:
            if not isinstance(node, yaml.MappingNode):  # a tag may call anything a mapping
                return super().construct_mapping(node, deep)
            given: dict[str, object] = {}
            for key, value in node.value:
                if isinstance(key, yaml.ScalarNode) and given.setdefault(key.value, value.value) != value.value:
                    raise yaml.constructor.ConstructorError(None, None, f"{key.value} is given twice", key.start_mark)
            return super().construct_mapping(node, deep)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", partial(Loader.construct_mapping, deep=True))
    # OpenCV writes its own dialect: "%YAML:1.0" is not a valid directive. rostopic ends with the mark of a document.
    body = re.sub(r"^%YAML.*", "", text, flags=re.MULTILINE).rstrip().removesuffix("\n---")
    body = _NO_SPACE.sub(r"\1 ", body)
    try:
        _check_structure(yaml.scan(body, Loader=Loader))
        return yaml.load(body, Loader=Loader)
    except yaml.MarkedYAMLError as error:
        what = "refused" if isinstance(error, yaml.constructor.ConstructorError) else "broken"
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise CalibrationError(f"{what} YAML in line {line}: {_one_line(error.problem)}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CalibrationError(f"broken YAML: {_one_line(error)}") from None


def _check_structure(tokens: Iterator[object]) -> None:
    """Refuse aliases and deep nesting, with which a small file would take very long to load."""
    depth = 0
    for name in (type(token).__name__ for token in tokens):
        depth += name.endswith("StartToken") - name.endswith("EndToken")
        if name == "AliasToken":
            raise CalibrationError("broken YAML: aliases are not allowed in a calibration")
        if depth > _MAX_DEPTH:
            raise CalibrationError(f"broken YAML: nested deeper than {_MAX_DEPTH} levels")


def parse_json(text: str) -> object:
    """Read JSON. A key that is given twice is an error."""

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        content = dict(pairs)
        if len(content) != len(pairs):
            raise CalibrationError("broken JSON: a key is given twice")
        return content

    try:
        return json.loads(text, object_pairs_hook=unique)
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"broken JSON: {_one_line(error)}") from None


def parse_xml(text: str) -> ElementTree.Element:
    """Read XML without a document type, whose entities could grow to any size."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise CalibrationError("refused XML: a document type is not allowed in a calibration")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise CalibrationError(f"broken XML: {_one_line(error)}") from None


def parse_arrays(data: bytes) -> dict[str, object]:
    """Read the arrays of a ``.npz`` file that belong to a camera."""
    try:
        arrays = parse_npz("arrays", io.BytesIO(data), _ARRAYS, _MAX_ARRAYS_BYTES, "a calibration")
    except SourceError as error:
        raise CalibrationError(str(error)) from None
    return {name: array.ravel().tolist() if array.ndim else array.item() for name, array in arrays.items()}


def _one_line(problem: object) -> str:
    return " ".join(str(problem).split())[:120]


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
