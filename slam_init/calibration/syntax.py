"""The syntaxes of calibration files: YAML in the dialect of OpenCV, JSON, XML, and arrays of numpy, all as mappings.

Files are not trusted. YAML is read by PyYAML's safe loader only; the tags ``!!opencv-matrix`` are read as plain
mappings. Aliases, deep nesting, document types of XML, and pickled objects are refused.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Hashable, Iterator
from functools import partial
from xml.etree import ElementTree

from slam_init.errors import CalibrationError, SourceError
from slam_init.system.numpy_file import parse_npz

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
