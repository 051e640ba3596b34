"""Readers of camera calibrations in the common formats, which are detected by their content.

* the YAML of this project (``model``, ``width``, ``height``, ``fx``, ``fy``, ``cx``, ``cy``, ``distortion_model``,
  ``distortion``);
* OpenCV ``FileStorage`` YAML and XML (``camera_matrix`` / ``K``, ``distortion_coefficients`` / ``D``);
* ORB-SLAM2 and 3 (``Camera.fx``, ``Camera1.fx``; ``Camera.type: KannalaBrandt8`` is fisheye);
* Kalibr camchain (``cam0: intrinsics``; pinhole, omni, ds, eucm), EuRoC ``sensor.yaml`` (``intrinsics``), ROS
  ``camera_info`` (``K``, ``D``);
* Basalt JSON (``value0``), and the YAML of camodocal and VINS (``model_type``);
* COLMAP ``cameras.txt``, whose pixel centres lie at .5: half a pixel is subtracted from the principal point.

YAML is read by PyYAML's safe loader only; the tags ``!!opencv-matrix`` are read as plain mappings.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam_init.calibration.formats import parse_colmap, parse_mapping
from slam_init.calibration.prior import AUTO, FIELDS_DEG, NUMBERS, camera_of_number, prior_camera
from slam_init.calibration.size_problem import size_remedy
from slam_init.errors import CalibrationError, plain_line
from slam_init.system.regular_file import read_regular, user_path
from slam_init.types.camera import Camera

_NUMBER = re.compile(r"\d{1,9}(\.\d{0,9})?")

# Limits for a file. The largest calibration files in use (Kalibr, of a rig) have 20 kB and four levels. Without the
# limits a video or a malicious file would keep the parser busy, whose time grows with the square of the depth.
_MAX_BYTES = 200_000
_MAX_DEPTH = 20

# Least share of the image for which the lens model must give rays. The circle of a fisheye may fill half of the image.
# With a wrong coefficient only a spot in the middle has rays.
_MIN_REACHED = 0.2


def load_camera(
    path: str | os.PathLike[str], image_size: tuple[int, int] | None = None, orientation: int = 1
) -> Camera:
    """Read a calibration of any known format.

    Parameters
    ----------
    path : str or path-like
        A file, ``f=1250`` (focal length in pixels), ``fov=72`` (degrees across the longer side), or ``auto``: nothing
        is known, and the focal length is estimated from the motion.
    image_size : (int, int), optional
        Width and height of the images in pixels. If the file states no size, this one is used. If the file states
        another size, it is refused, since the calibration of other images gives a wrong map.
    orientation : int
        The EXIF orientation of the images, for the message of this refusal.

    Returns
    -------
    Camera

    Raises
    ------
    CalibrationError
        If the file is missing, not a calibration, or an impossible one. The message is one line that names file and
        key.
    """
    given = user_path(path, CalibrationError)
    text = os.fspath(path)
    if text in AUTO or text.startswith(NUMBERS):
        if image_size is None:
            raise CalibrationError(f"--camera {text!r} needs the size of the images")
        return prior_camera(image_size) if text in AUTO else camera_of_number(text, image_size)
    path = given
    if _NUMBER.fullmatch(text) and not path.exists():
        degrees = f", or fov={text} for degrees" if float(text) <= FIELDS_DEG[1] else ""
        raise CalibrationError(f"--camera {text}: say f={text} for a focal length in pixels{degrees}")
    if "=" in text and not path.exists():
        raise CalibrationError(f"--camera {text!r}: give a file, f=1250 (pixels) or fov=72 (degrees)")
    text = _read_text(path)
    try:
        camera = _parse(path, text, image_size)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None
    _check(str(path), camera, image_size, orientation)
    return replace(camera, source="file")


def camera_of(place: str, content: Mapping[str, object], image_size: tuple[int, int] | None = None) -> Camera:
    """Make a camera of a calibration that is no file, for example a message."""
    try:
        camera = parse_mapping(content, image_size)
    except CalibrationError as error:
        raise CalibrationError(f"{place}: {error}") from None
    _check(place, camera, image_size)
    return replace(camera, source="file")


def _check(place: str, camera: Camera, image_size: tuple[int, int] | None, orientation: int = 1) -> None:
    """Refuse a calibration of other images, and distortion coefficients that leave most of the image without rays."""
    if image_size is not None and (camera.width, camera.height) != image_size:
        ours, theirs = f"{camera.width}x{camera.height}", f"{image_size[0]}x{image_size[1]}"
        otherwise = "give their calibration, or scale fx, fy, cx, cy if the images are resized"
        remedy = size_remedy(image_size, (camera.width, camera.height), orientation, otherwise)
        raise CalibrationError(f"{place}: calibration is for {ours} images, but the images are {theirs}: {remedy}")
    grid = np.stack(np.meshgrid(np.linspace(0, camera.width - 1, 21), np.linspace(0, camera.height - 1, 21)), axis=-1)
    reached = float(np.isfinite(camera.bearings(grid.reshape(-1, 2))).all(axis=1).mean())
    if reached < _MIN_REACHED:
        raise CalibrationError(
            f"{place}: distortion {list(camera.distortion)} gives rays for {100 * reached:.0f} % of the image only: "
            "check the coefficients and their order"
        )


def load_yaml(path: str | os.PathLike[str]) -> object:
    """Read a YAML file by the safe loader."""
    path = Path(path)
    try:
        return _parse_yaml(_read_text(path))
    except CalibrationError as error:
        message = str(error)
        raise CalibrationError(message if message.startswith(plain_line(str(path))) else f"{path}: {message}") from None


def _read_text(path: Path) -> str:
    what = "a calibration: give a YAML, JSON, XML or COLMAP file, or auto"
    data = read_regular(path, _MAX_BYTES, what, CalibrationError)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise CalibrationError(f"{path}: not a text file: give a YAML, JSON, XML or COLMAP calibration")
    if not text.strip():
        raise CalibrationError(f"{path}: the file is empty")
    return text


def _parse(path: Path, text: str, image_size: tuple[int, int] | None) -> Camera:
    if path.suffix.lower() == ".xml" or text.lstrip().startswith("<"):
        return parse_mapping(_parse_xml(text), image_size)
    if path.suffix.lower() == ".txt":
        return parse_colmap(text)
    is_json = path.suffix.lower() == ".json"
    content = _parse_json(text) if is_json else _parse_yaml(text)
    if not isinstance(content, dict):
        raise CalibrationError("not a calibration: expected lines of the form key: value")
    return parse_mapping(content, image_size)


def _parse_yaml(text: str) -> object:
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

    def construct_matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> object:
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", construct_matrix)
    # OpenCV writes its own dialect: "%YAML:1.0" is not a valid directive.
    lines = text.splitlines()
    body = "\n".join(line for line in lines if not line.startswith("%YAML"))
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
    import yaml

    opening = (
        yaml.FlowSequenceStartToken,
        yaml.FlowMappingStartToken,
        yaml.BlockSequenceStartToken,
        yaml.BlockMappingStartToken,
    )
    closing = (yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken, yaml.BlockEndToken)
    depth = 0
    for token in tokens:
        depth += isinstance(token, opening) - isinstance(token, closing)
        if isinstance(token, yaml.AliasToken):
            raise CalibrationError("broken YAML: aliases are not allowed in a calibration")
        if depth > _MAX_DEPTH:
            raise CalibrationError(f"broken YAML: nested deeper than {_MAX_DEPTH} levels")


def _parse_json(text: str) -> object:
    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        content = dict(pairs)
        if len(content) != len(pairs):
            raise CalibrationError("broken JSON: a key is given twice")
        return content

    try:
        return json.loads(text, object_pairs_hook=unique)
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"broken JSON: {_one_line(error)}") from None


def _parse_xml(text: str) -> dict[str, object]:
    """Read the XML of OpenCV's FileStorage by OpenCV: matrices, numbers and strings at the top level."""
    import cv2

    content: dict[str, object] = {}
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        for key in root.keys():  # noqa: SIM118 (a FileNode is not a mapping)
            node = root.getNode(key)
            if node.isMap() and node.mat() is not None:
                content[key] = {"data": node.mat().ravel().tolist()}
            elif node.isReal() or node.isInt():
                content[key] = node.real()
            elif node.isString():
                content[key] = node.string()
    except (cv2.error, SystemError):
        raise CalibrationError("broken XML: expected a file of OpenCV's FileStorage") from None
    return content


def _one_line(problem: object) -> str:
    return " ".join(str(problem).split())[:120]
