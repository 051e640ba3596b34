"""The formats of :mod:`slam_init.calibration.files`: one function per format converts a parsed file to a camera.

Error messages name the key; the caller adds the name of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

__all__ = ["parse_colmap", "parse_mapping"]

Size = tuple[int, int] | None
#: The keys and values of a file. A value is checked when it is read.
Content = Mapping[str, object]

#: Names of the distortion models in all formats, lower case -> model of :class:`~slam_init.types.camera.Camera`.
_MODELS = {
    "none": "pinhole",
    "": "pinhole",
    "pinhole": "pinhole",
    "radtan": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "fisheye",
    "equi": "fisheye",
    "fisheye": "fisheye",
    "kannalabrandt8": "fisheye",
}


def parse_mapping(content: Content, image_size: Size) -> Camera:
    """Convert the content of a YAML or XML file. The format is detected by its keys.

    Parameters
    ----------
    content : dict
        Top level of the file.
    image_size : (int, int) or None
        Width and height in pixels, for files that state no size.

    Returns
    -------
    Camera

    Raises
    ------
    CalibrationError
        If the format is unknown, or if a value is missing or impossible.
    """
    for keys, parse in _FORMATS:
        if any(key in content for key in keys):
            return _with_readout(content, parse(content, image_size))
    raise CalibrationError(
        "no known calibration format: expected fx, fy, cx, cy; camera_matrix or K; Camera.fx; "
        "cam0 or intrinsics (Kalibr, EuRoC)"
    )


def parse_colmap(text: str) -> Camera:
    """Convert a COLMAP ``cameras.txt`` with one camera: ``id MODEL width height params``.

    Parameters
    ----------
    text : str
        Content of the file.

    Returns
    -------
    Camera

    Raises
    ------
    CalibrationError
        If there is not exactly one camera, or if its model or a value is not supported.
    """
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    if len(lines) != 1:
        raise CalibrationError(f"{len(lines)} cameras: expected a COLMAP cameras.txt with exactly one")
    fields = lines[0]
    if len(fields) < 4 or fields[1] not in _COLMAP:
        raise CalibrationError(f"not a COLMAP camera: id, model of {', '.join(_COLMAP)}, width, height, params")
    model, names = fields[1], _COLMAP[fields[1]].split()
    if len(fields) != 4 + len(names):
        raise CalibrationError(f"{model} takes {len(names)} parameters, found {len(fields) - 4}")
    values = {name: _number({name: text}, name) for name, text in zip(names, fields[4:], strict=True)}
    fx = values["f"] if "f" in values else values["fx"]
    fy = values["f"] if "f" in values else values["fy"]
    if model == "OPENCV_FISHEYE":
        kind, distortion = "fisheye", [values[k] for k in ("k1", "k2", "k3", "k4")]
    else:
        kind = "radtan"
        distortion = [values.get(k, 0.0) for k in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
    size = _size({"width": fields[2], "height": fields[3]}, "width", "height", None)
    # The pixel centres of COLMAP lie at .5, those of this project at integers.
    return _camera(kind, size, (fx, fy, values["cx"] - 0.5, values["cy"] - 0.5), distortion)


def _own(content: Content, image_size: Size) -> Camera:
    """The YAML format of this project."""
    model = _model(content, "distortion_model", "model")
    size = _size(content, "width", "height", image_size)
    focal = tuple(_number(content, key) for key in ("fx", "fy", "cx", "cy"))
    camera = _camera(model, size, focal, _numbers(content, "distortion", default=[]))
    return replace(camera, focal_sigma=_number(content, "focal_sigma")) if "focal_sigma" in content else camera


def _opencv(content: Content, image_size: Size) -> Camera:
    """OpenCV's FileStorage, and ROS ``camera_info`` with both spellings of its keys."""
    key = _first(content, "camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1", "K1")
    K = _numbers(content, key)
    if len(K) != 9:
        raise CalibrationError(f"{key}: expected a 3x3 matrix, found {len(K)} numbers")
    if K[8] != 1 or any(K[i] != 0 for i in (1, 3, 6, 7)):
        raise CalibrationError(f"{key}: expected [fx 0 cx, 0 fy cy, 0 0 1]; a skew is not supported")
    names = (
        "distortion_coefficients",
        "Distortion_Coefficients",
        "distCoeffs",
        "dist_coeffs",
        "D",
        "d",
        "D1",
    )
    distortion_key = next((name for name in names if name in content), None)
    distortion = _numbers(content, distortion_key) if distortion_key else []
    model = _model(content, "distortion_model", "camera_model", "model", "Camera.type")
    if content.get("fisheye_model") in (1, True):
        model = "fisheye"
    width, height = (
        next((name for name in pair if name in content), pair[0])
        for pair in (("image_width", "image_Width", "width"), ("image_height", "image_Height", "height"))
    )
    return _camera(model, _size(content, width, height, image_size), (K[0], K[4], K[2], K[5]), distortion)


def _orb_slam(content: Content, image_size: Size) -> Camera:
    """ORB-SLAM2 (``Camera.fx``) and ORB-SLAM3 (``Camera1.fx``)."""
    prefix = "Camera1." if "Camera1.fx" in content else "Camera."
    kind = str(content.get("Camera.type", "PinHole"))
    model = {"pinhole": "radtan", "rectified": "pinhole", "kannalabrandt8": "fisheye"}.get(kind.lower())
    if model is None:
        raise CalibrationError(f"Camera.type is {kind!r}: use PinHole, Rectified or KannalaBrandt8")
    names = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    distortion = [_number(content, prefix + name, default=0.0) for name in names]
    focal = tuple(_number(content, prefix + name) for name in ("fx", "fy", "cx", "cy"))
    size = _size(content, "Camera.width", "Camera.height", image_size)
    return _camera(model, size, focal, [] if model == "pinhole" else distortion)


def _kalibr(content: Content, image_size: Size) -> Camera:
    """A Kalibr camchain: its first camera."""
    camera = content["cam0"]
    if not isinstance(camera, dict):
        raise CalibrationError("cam0 is not a camera: expected intrinsics, resolution and so on in it")
    return _with_readout(camera, _sensor(camera, image_size, "cam0: "))


def _sensor(content: Content, image_size: Size, where: str = "") -> Camera:
    """One camera of Kalibr, or EuRoC's ``sensor.yaml``: ``intrinsics: [fu, fv, cu, cv]``."""
    projection = str(content.get("camera_model", "pinhole")).lower()
    if projection != "pinhole":
        raise CalibrationError(f"{where}camera_model is {projection!r}: only pinhole is supported")
    focal = _numbers(content, "intrinsics")
    if len(focal) != 4:
        raise CalibrationError(f"{where}intrinsics: expected [fx, fy, cx, cy], found {len(focal)} numbers")
    key = "distortion_coeffs" if "distortion_coeffs" in content else "distortion_coefficients"
    model = _model(content, "distortion_model")
    size = image_size
    if "resolution" in content:
        resolution = _numbers(content, "resolution")
        if len(resolution) != 2:
            raise CalibrationError(f"{where}resolution: expected [width, height]")
        size = _size({"width": resolution[0], "height": resolution[1]}, "width", "height", None)
    if size is None:
        raise CalibrationError(f"{where}resolution is missing")
    return _camera(model, size, tuple(focal), _numbers(content, key, default=[]))


def _with_readout(content: Content, camera: Camera) -> Camera:
    """The camera with the readout of its rolling shutter, where the file states it.

    It is ``readout_ms`` for all rows, with ``readout_direction``, or ``line_delay`` of Kalibr: seconds for each row.
    """
    direction = str(content.get("readout_direction", camera.readout_direction))
    if "readout_ms" in content:
        return replace(camera, readout_ms=_number(content, "readout_ms"), readout_direction=direction)
    if "line_delay" in content:
        readout_ms = 1e3 * _number(content, "line_delay") * camera.height
        return replace(camera, readout_ms=abs(readout_ms), readout_direction="up" if readout_ms < 0 else "down")
    return camera


# The keys of each format, any of which identifies it, and its parser. The first format that fits is taken.
_FORMATS: tuple[tuple[tuple[str, ...], Callable[[Content, Size], Camera]], ...] = (
    (("cam0",), _kalibr),
    (("Camera.fx", "Camera1.fx"), _orb_slam),
    (("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1", "K1"), _opencv),
    (("intrinsics",), _sensor),
    (("fx", "fy", "cx", "cy", "model", "distortion_model"), _own),
)

# Parameters of the camera models of COLMAP.
_COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
}


def _camera(model: str, size: tuple[int, int], focal: tuple[float, ...], distortion: list[float]) -> Camera:
    """Make a camera; trailing zero coefficients are added or removed to get the number that the model takes."""
    k = list(distortion)
    if model == "pinhole" and any(k):
        model = "radtan"  # files of OpenCV have this model and do not name it
    if model == "pinhole":
        k = []
    elif model == "fisheye":
        if len(k) != 4:
            raise CalibrationError(f"{len(k)} distortion coefficients for a fisheye camera: give k1, k2, k3, k4")
    else:
        if any(k[5:]):
            raise CalibrationError(
                "distortion has a rational or thin prism part: calibrate with k1, k2, p1, p2, k3 only"
            )
        k = (k[:5] + [0.0] * 4)[: max(4, min(len(k), 5))]
        if len(k) == 5 and k[4] == 0:
            k = k[:4]
        if not any(k):
            model, k = "pinhole", []
    fx, fy, cx, cy = focal
    return Camera(model, *size, fx, fy, cx, cy, tuple(k))


def _first(content: Content, *names: str) -> str:
    return next(name for name in names if name in content)


def _model(content: Content, *keys: str) -> str:
    """The model under the first key that is present; ``pinhole`` if none is."""
    for key in keys:
        if content.get(key) is not None:
            name = str(content[key]).lower()
            if name not in _MODELS:
                known = ", ".join(name for name in _MODELS if name)
                raise CalibrationError(f"{key} is {content[key]!r}: use one of {known}")
            return _MODELS[name]
    return "pinhole"


def _number(content: Content, key: str, default: float | None = None) -> float:
    """A finite number. Text that holds a number is accepted, since YAML 1.1 reads ``1e-5`` as text."""
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


def _numbers(content: Content, key: str, default: list[float] | None = None) -> list[float]:
    """A list of finite numbers: flat, nested by rows, or under ``data`` as in files of OpenCV."""
    value = content.get(key)
    if isinstance(value, dict):
        value = value.get("data")
    if value is None and default is not None:
        return default
    if not isinstance(value, list):
        raise CalibrationError(f"{key} is {str(value)[:40]!r}: give a list of numbers")
    flat = [item for row in value for item in (row if isinstance(row, list) else [row])]
    return [_number({key: item}, key) for item in flat]


def _size(content: Content, width_key: str, height_key: str, image_size: Size) -> tuple[int, int]:
    """Width and height of the file, or of the images if the file has none."""
    if width_key not in content and height_key not in content and image_size is not None:
        return image_size
    sides = _number(content, width_key), _number(content, height_key)
    if any(side != round(side) for side in sides):
        raise CalibrationError(f"image size {sides[0]}x{sides[1]}: give whole pixels")
    return round(sides[0]), round(sides[1])
