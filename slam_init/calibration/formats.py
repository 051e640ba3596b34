"""The formats of calibration files: two tables, each of recognizers and readers.

A text is recognized by its content, whatever the name of the file; its reader makes a mapping of it. A mapping is
recognized by its keys; its reader takes out the mapping of one camera, which :func:`camera_of_content` converts. A form
that is known and not read has a reader that raises an error with what to write instead.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import NoReturn
from xml.etree.ElementTree import Element

from slam_init.calibration.models import (
    COLMAP_PARAMETERS,
    camera_of_values,
    check_centre,
    model_of,
    named_coefficients,
    shape_names,
    states_model,
)
from slam_init.calibration.values import Content, Section, Size, parse_json, parse_xml, parse_yaml
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

# -- one camera ------------------------------------------------------------------------------------


_MATRICES = ("camera_matrix", "cameramatrix", "intrinsic_matrix", "mtx", "k", "m1", "k1")
_LISTS = ("intrinsics", "calibration")
_FOCAL = ("fx", "fy", "cx", "cy")
_DISTORTION = ("distortion", "distcoeffs", "dist_coeffs", "dist", "d", "d1")
# Least displacement over the image by a skew that counts. A calibration of the same images without a skew takes most of
# the displacement into the principal point and the poses.
_MAX_SKEW_PX = 1.0

_WRITE = "write a YAML with model, width, height, fx, fy, cx, cy, distortion (docs/how-to/camera.md)"
_OKVIS = (
    "a list of cameras, the form of OKVIS: write a YAML with resolution (image_dimension), intrinsics (focal_length, "
    "principal_point), distortion_model (distortion_type) and distortion_coefficients of one camera"
)
_OPENSFM = (
    "the form of OpenSfM, whose numbers are relative to the longer side: multiply focal_x, focal_y, c_x and c_y by it, "
    f"add (width - 1) / 2 to c_x and (height - 1) / 2 to c_y, and {_WRITE}"
)
_KALIBR_RESULTS = "the results of Kalibr as text, which state no image size: give the *camchain.yaml beside them"
_ZED = f"the settings of a ZED, which have a camera for each resolution and side: with the numbers of one, {_WRITE}"


def camera_of_content(content: Content, image_size: Size) -> Camera:
    """Convert the content of a file."""
    content = _parts(content).get("cameras", content)
    read = next((read for fits, read in _MAPPINGS if fits(content)), None)
    content = content if read is None else read(content)
    section = Section(content)
    if not _has_focal(content) and not any(map(states_model, section.values)):
        raise CalibrationError(
            "no known calibration format: expected fx, fy, cx, cy; camera_matrix or K; intrinsics (Kalibr, EuRoC); "
            "Camera.fx; value0 (Basalt); model_type (camodocal)"
        )
    model, size = model_of(section), section.size(image_size)
    shape, focal, after, skew = _intrinsics(section, model)
    distortion = [*shape, *(_distortion_list(section) or after)] or named_coefficients(section, model)
    if len(focal) == 4 and focal[0] == focal[1] == 0:
        raise CalibrationError("the focal lengths are 0: the camera was not calibrated, so calibrate it, or give auto")
    camera = _without_skew(camera_of_values(model, size, focal, distortion), skew)
    if not section.states_size:
        check_centre(camera)
    if "focal_sigma" in section.values:
        camera = replace(camera, focal_sigma=section.number("focal_sigma"))
    return _with_readout(camera, section)


def _has_focal(content: Content) -> bool:
    """Whether a mapping has the focal lengths itself and not in a part of its own."""
    values = Section(content).values
    found = [values[name] for name in (*_MATRICES, *_LISTS, *_FOCAL) if name in values]
    return any(not isinstance(value, dict) or "data" in value for value in found)


def _intrinsics(section: Section, model: str) -> tuple[list[float], list[float], list[float], float]:
    """Coefficients of the shape, ``fx fy cx cy``, the coefficients after them, and the skew."""
    name = section.first(*_MATRICES)
    if name is not None and isinstance(section.values[name], list | dict):  # k1 may be a coefficient
        K, key = section.numbers(name), section.key(name)
        if len(K) != 9:
            raise CalibrationError(f"{key}: expected a 3x3 matrix, found {len(K)} numbers")
        if any(K) and (K[8] != 1 or K[3] or K[6] or K[7]):
            raise CalibrationError(f"{key}: expected [fx 0 cx, 0 fy cy, 0 0 1]")
        return [], [K[0], K[4], K[2], K[5]], [], K[1]
    if name := section.first(*_LISTS):
        names, values = [*shape_names(model), *_FOCAL], section.numbers(name)
        end = len(names)
        if len(values) < end or (name == "intrinsics" and len(values) > end):
            expected = ", ".join(names)
            raise CalibrationError(f"{section.key(name)}: expected [{expected}], found {len(values)} numbers")
        return values[: end - 4], values[end - 4 : end], values[end:], 0.0
    if model == "equirectangular" and not section.first(*_FOCAL):
        return [], [], [], 0.0
    return [], [section.number(name) for name in _FOCAL], [], section.number("skew", 0.0)


def _distortion_list(section: Section) -> list[float]:
    """The list of distortion coefficients; empty where there is none."""
    lists = [name for name, value in section.values.items() if isinstance(value, list | dict)]
    names = [name for name in section.values if name in _DISTORTION or ("distort" in name and name in lists)]
    names = [name for name in names if not states_model(name)]
    if len(names) > 1:
        keys = " and ".join(map(section.key, names))
        raise CalibrationError(f"{keys} both state a distortion: give one list, as in distortion: [k1, k2, p1, p2]")
    return section.numbers(names[0]) if names else []


def _without_skew(camera: Camera, skew: float) -> Camera:
    moved_px = abs(skew) * camera.height / camera.fy
    if moved_px >= _MAX_SKEW_PX:
        problem = f"a skew of {skew:g} px moves pixels by {moved_px:.1f} px over the image"
        raise CalibrationError(f"{problem}, and no model here has one: calibrate without a skew")
    note = f"the skew of the calibration is left out: it moves pixels by {moved_px:.2f} px over the image"
    return replace(camera, notes=(note,)) if skew else camera


def _with_readout(camera: Camera, section: Section) -> Camera:
    """The camera with the readout of its rolling shutter, where the file states it.

    It is ``readout_ms`` for all rows, with ``readout_direction``, or ``line_delay`` of Kalibr: seconds for each row.
    """
    direction = str(section.values.get("readout_direction", camera.readout_direction))
    if "readout_ms" in section.values:
        return replace(camera, readout_ms=section.number("readout_ms"), readout_direction=direction)
    if "line_delay" in section.values:
        readout_ms = 1e3 * section.number("line_delay") * camera.height
        return replace(camera, readout_ms=abs(readout_ms), readout_direction="up" if readout_ms < 0 else "down")
    return camera


# -- mappings --------------------------------------------------------------------------------------


def _refuse(message: str) -> Callable[[object], NoReturn]:
    """A reader of a form that is not read."""

    def refuse(_: object) -> NoReturn:
        raise CalibrationError(message)

    return refuse


def _parts(content: Content) -> dict[str, Content]:
    """The mappings in a mapping."""
    return {key: value for key, value in content.items() if isinstance(value, dict)}


def _basalt(content: Content) -> Content:
    """The JSON of Basalt: its first camera."""
    value = _parts(content).get("value0", {})
    cameras, sizes = value.get("intrinsics"), value.get("resolution")
    if not (isinstance(cameras, list) and cameras and isinstance(cameras[0], dict)):
        raise CalibrationError("value0: expected intrinsics, a list of cameras, in it")
    return {
        **_parts(cameras[0]).get("intrinsics", {}),
        "camera_type": cameras[0].get("camera_type", "not stated"),
        "resolution": sizes[0] if isinstance(sizes, list) and sizes else None,
    }


#: What camodocal calls focal lengths and principal point in some of its
_CAMODOCAL = {"mu": "fx", "mv": "fy", "gamma1": "fx", "gamma2": "fy", "u0": "cx", "v0": "cy"}


def _camodocal(content: Content) -> Content:
    """The YAML of camodocal, as in VINS-Mono and VINS-Fusion."""
    flat = {key: value for key, value in content.items() if key != "fisheye"}  # the flag of VINS is a mask
    for part in ("mirror_parameters", "distortion_parameters", "projection_parameters"):
        flat |= _parts({part: flat.pop(part, None)}).get(part, {})
    if "mu" in flat:  # its coefficients start with that of the angle itself, which is 1
        flat |= {f"k{i - 1}": flat.get(f"k{i}") for i in range(2, 6)}
    return {_CAMODOCAL.get(key, key): value for key, value in flat.items()}


def _cameras(content: Content) -> list[str]:
    """The parts of a mapping that are cameras; of Kalibr the first."""
    if "cam0" in content:
        return ["cam0"]
    parts = {} if _has_focal(content) else _parts(content)
    return [key for key in parts if _has_focal(parts[key])] or [key for key in parts if key.lower() == "camera"]


def _part(content: Content) -> Content:
    """The camera in a part of its own, with what the file states for all."""
    names, parts = _cameras(content), _parts(content)
    if len(names) > 1:
        shown = ", ".join(names)[:80]
        raise CalibrationError(f"has the cameras {shown}: copy what is below one of them into a file of its own")
    if names[0] not in parts:
        raise CalibrationError(f"{names[0]} is not a camera: expected intrinsics, resolution and so on in it")
    return {key: value for key, value in content.items() if key not in names} | dict(parts[names[0]])


#: Recognizers and readers of mappings; the first that fits is taken. A mapping that none fits is a camera itself.
_MAPPINGS: tuple[tuple[Callable[[Content], object], Callable[[Content], Content]], ...] = (
    (lambda content: isinstance(content.get("cameras"), list), _refuse(_OKVIS)),
    (lambda content: any("projection_type" in part for part in _parts(content).values()), _refuse(_OPENSFM)),
    (lambda content: "value0" in content, _basalt),
    (lambda content: "model_type" in content or "projection_parameters" in content, _camodocal),
    (_cameras, _part),
)


# -- texts -----------------------------------------------------------------------------------------


def content_of_text(text: str) -> Content:
    """Read a text of any format."""
    content = next(read for fits, read in _TEXTS if fits(text))(text)
    if isinstance(content, list) and content and isinstance(content[0], dict):
        content = content[0]  # a reconstruction of OpenSfM
    if not isinstance(content, dict):
        raise CalibrationError("not a calibration: expected lines of the form key: value")
    return {str(key): value for key, value in content.items()}


def parse_colmap(text: str) -> Camera:
    """Convert a line of a COLMAP ``cameras.txt``: ``id MODEL width height params``."""
    return camera_of_content(_colmap(text), None)


def _the_only(cameras: list[Content]) -> Content:
    """One of several cameras that are equal."""
    if not cameras or any(camera != cameras[0] for camera in cameras):
        raise CalibrationError(f"{len(cameras)} cameras: give a file with the one that took the images")
    return cameras[0]


def _colmap(text: str) -> Content:
    return _the_only([_colmap_line(line.split()) for line in _lines(text)])


def _colmap_line(fields: list[str]) -> Content:
    """One camera. Pixel centres of COLMAP lie at .5, those of this project at integers."""
    if len(fields) < 4 or fields[1] not in COLMAP_PARAMETERS:
        known = ", ".join(COLMAP_PARAMETERS)
        raise CalibrationError(f"not a COLMAP camera: id, model of {known}, width, height, params")
    names = COLMAP_PARAMETERS[fields[1]].split()
    if len(fields) - 4 != len(names):
        raise CalibrationError(f"{fields[1]} takes {len(names)} parameters, found {len(fields) - 4}")
    texts = Section(dict(zip(["width", "height", *names], fields[2:], strict=True)))
    values = {name: texts.number(name) - 0.5 * (name in ("cx", "cy")) for name in texts.values}
    if "f" in values:
        values["fx"] = values["fy"] = values["f"]
    return {"model": fields[1], "k1": 0.0, **values}


def _ost(text: str) -> Content:
    """The ``ost.txt`` of ROS: each value stands in the lines below its name."""
    content: dict[str, list[str]] = {}
    name = ""
    for line in _lines(text):
        if _is_numeric(line):
            content.setdefault(name, []).extend(_fields(line))
        else:
            name = line.strip()
    matrix, distortion = content.get("camera matrix", []), content.get("distortion", [])
    if len(matrix) > 9:
        raise CalibrationError("several cameras: keep the lines of the one that took the images")
    if len(distortion) == 4:
        raise CalibrationError("four coefficients without a model, as of a fisheye: give ost.yaml, which states it")
    found: dict[str, object] = {side: content[side][0] for side in ("width", "height") if side in content}
    return found | {"K": matrix, "D": distortion}


def _rows(text: str) -> Content:
    """Numbers alone: ``fx fy cx cy``, perhaps with coefficients of OpenCV, or a matrix of 3x3."""
    values = [float(field) for line in _lines(text) for field in _fields(line)]
    if len(values) == 9 and not (values[3] or values[6] or values[7]):
        return {"K": values}
    if len(values) not in (4, 8, 9):
        raise CalibrationError(f"{len(values)} numbers: expected fx fy cx cy [k1 k2 p1 p2 [k3]], or a matrix of 3x3")
    return {"calibration": values}


def _is_dso(text: str) -> bool:
    """Whether the first line has parameters, perhaps after the name of a model, and the second one an image size."""
    lines = _lines(text)[:2]
    if len(lines) < 2 or not re.fullmatch(r"\s*\d+\s+\d+\s*", lines[1]):
        return False
    first, *values = _fields(lines[0])
    return _is_numeric(" ".join(values)) and len(values) + _is_numeric(first) in (4, 5, 8)


def _dso(text: str) -> Content:
    """The ``camera.txt`` of DSO and LSD-SLAM: parameters, then the image size; the rest states how they rectify."""
    parameters, sides = map(_fields, _lines(text)[:2])
    named = [] if _is_numeric(parameters[0]) else [parameters.pop(0)]
    values = [float(field) for field in parameters]
    if len(values) == 5 and values[4] == 0:
        values.pop()
    model = [*named, {4: "pinhole", 5: "fov", 8: "radtan"}[len(values)]][0].lower()
    width, height = Section({"resolution": sides}).size(None)
    # Relative to the size; their pixel centres lie at .5, those of others at integers.
    if values[2] < 1 and values[3] < 1:
        values[:4] = width * values[0], height * values[1], width * values[2] - 0.5, height * values[3] - 0.5
    return {"model": model, "width": width, "height": height, "calibration": values}


def _xml(text: str) -> Content:
    """The XML of OpenCV's FileStorage, or of Metashape."""
    root = parse_xml(text)
    if calibrations := list(root.iter("calibration")):
        cameras = [list(sensor.iter("calibration")) for sensor in root.iter("sensor")] or [calibrations]
        # One that somebody stated stands before that of the images; one of EXIF has no k1.
        best = [max(some, key=lambda one: len({"f", "k1"} & {node.tag for node in one})) for some in cameras if some]
        return _the_only([_metashape(one) for one in best])
    content: dict[str, object] = {}
    for node in root:
        data = node.findtext("data")
        content[node.tag] = (node.text or "").strip().strip('"') if data is None else {"data": data.split()}
    return content


def _metashape(calibration: Element) -> Content:
    """A calibration of Metashape: the principal point from the centre, p1 and p2 the other way round than in OpenCV."""
    section = Section({**{node.tag: node.text for node in calibration}, **calibration.attrib})
    resolution = calibration.find("resolution")
    width, height = (section if resolution is None else Section(resolution.attrib)).size(None)
    kind = str(section.values.get("type", section.values.get("projection", "frame")))
    unread = ["p3", "p4", "k4"][: 2 if kind == "fisheye" else 3]  # k4 is no coefficient of OpenCV's polynomial
    if kind not in ("frame", "fisheye") or any(section.number(name, 0.0) for name in unread):
        problem = f"Metashape's type {kind} with {', '.join(unread)}"
        raise CalibrationError(f"{problem}: use frame or fisheye, and 0 for these")
    f, b1, skew, cx, cy = section.number("f"), *(section.number(name, 0.0) for name in ("b1", "b2", "cx", "cy"))
    K = [f + b1, skew, (width - 1) / 2 + cx, 0, f, (height - 1) / 2 + cy, 0, 0, 1]
    values = {name: section.number(name, 0.0) for name in ("k1", "k2", "k3", "k4")}
    p1, p2 = section.number("p2", 0.0), section.number("p1", 0.0)
    model = "radtan" if kind == "frame" else "thin_prism_fisheye" if p1 or p2 else "fisheye"
    return {"model": model, "resolution": [width, height], "K": K, "p1": p1, "p2": p2, **values}


def _lines(text: str) -> list[str]:
    """The lines of a table that are neither empty nor comments."""
    return [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("#", "%", "//"))]


def _fields(text: str) -> list[str]:
    return re.sub(r"[\[\](),;]", " ", text).split()


def _is_numeric(text: str) -> bool:
    """Whether a text is numbers alone."""
    number = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
    fields = [field for line in _lines(text) for field in _fields(line)]
    return bool(fields) and all(map(number.fullmatch, fields))


#: Recognizers and readers of texts; the first that fits is taken.
_TEXTS: tuple[tuple[Callable[[str], object], Callable[[str], object]], ...] = (
    (re.compile(r"\s*<").match, _xml),
    (re.compile(r"^(Calibration results|Camera-system parameters)", re.MULTILINE).search, _refuse(_KALIBR_RESULTS)),
    (re.compile(r"^\[(LEFT|RIGHT)_CAM_", re.MULTILINE).search, _refuse(_ZED)),
    (re.compile(r"^[ \t]*camera matrix[ \t]*\r?$", re.MULTILINE).search, _ost),
    (re.compile(r"^[ \t]*\d+[ \t]+[A-Z_]+[ \t]+\d+[ \t]+\d+", re.MULTILINE).search, _colmap),
    (_is_dso, _dso),
    (_is_numeric, _rows),
    (re.compile(r'\s*(\{\s*("|\}|$)|\[\s*\{)').match, parse_json),
    (lambda _: True, parse_yaml),
)
