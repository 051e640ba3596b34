"""The formats of :mod:`slam_init.calibration.files`: one function per format converts a parsed file to a camera.

Error messages name the key; the caller adds the name of the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from slam_init.calibration.colmap_models import COLMAP_PARAMETERS, camera_of_colmap
from slam_init.calibration.making import camera_of_values, model_named
from slam_init.calibration.values import Content, Size, integer_size, mapping_of, number_of, numbers_of
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera


def parse_mapping(content: Content, image_size: Size) -> Camera:
    """Convert the content of a YAML or XML file. The format is detected by its keys."""
    for keys, parse in _FORMATS:
        if any(key in content for key in keys):
            return _with_readout(content, parse(content, image_size))
    raise CalibrationError(
        "no known calibration format: expected fx, fy, cx, cy; camera_matrix or K; Camera.fx; "
        "cam0 or intrinsics (Kalibr, EuRoC); value0 (Basalt); model_type (camodocal)"
    )


def parse_colmap(text: str) -> Camera:
    """Convert a COLMAP ``cameras.txt`` with one camera: ``id MODEL width height params``."""
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    if len(lines) != 1:
        raise CalibrationError(f"{len(lines)} cameras: expected a COLMAP cameras.txt with exactly one")
    fields = lines[0]
    if len(fields) < 4 or fields[1] not in COLMAP_PARAMETERS:
        raise CalibrationError(
            f"not a COLMAP camera: id, model of {', '.join(COLMAP_PARAMETERS)}, width, height, params"
        )
    size = integer_size({"width": fields[2], "height": fields[3]}, "width", "height", None)
    names = COLMAP_PARAMETERS[fields[1]].split()
    names += [f"parameter {i + 1}" for i in range(len(names), len(fields) - 4)]
    values = [number_of({name: text}, name) for name, text in zip(names, fields[4:], strict=False)]
    return camera_of_colmap(fields[1], *size, values)


def _own(content: Content, image_size: Size) -> Camera:
    """The YAML format of this project."""
    model = _model(content, "distortion_model", "model")
    size = integer_size(content, "width", "height", image_size)
    names = ("fx", "fy", "cx", "cy")
    whole_sphere = model == "equirectangular" and not any(name in content for name in names)
    focal = () if whole_sphere else tuple(number_of(content, name) for name in names)
    camera = camera_of_values(model, size, focal, numbers_of(content, "distortion", default=[]))
    return replace(camera, focal_sigma=number_of(content, "focal_sigma")) if "focal_sigma" in content else camera


def _opencv(content: Content, image_size: Size) -> Camera:
    """OpenCV's FileStorage, and ROS ``camera_info`` with both spellings of its keys."""
    key = _first(content, "camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1", "K1")
    K = numbers_of(content, key)
    if len(K) != 9:
        raise CalibrationError(f"{key}: expected a 3x3 matrix, found {len(K)} numbers")
    if K[8] != 1 or any(K[i] != 0 for i in (1, 3, 6, 7)):
        raise CalibrationError(f"{key}: expected [fx 0 cx, 0 fy cy, 0 0 1]; a skew is not supported")
    names = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "d", "D1")
    distortion_key = next((name for name in names if name in content), None)
    distortion = numbers_of(content, distortion_key) if distortion_key else []
    model = _model(content, "distortion_model", "camera_model", "model", "Camera.type")
    if content.get("fisheye_model") in (1, True):
        model = "fisheye"
    width, height = (
        next((name for name in pair if name in content), pair[0])
        for pair in (("image_width", "image_Width", "width"), ("image_height", "image_Height", "height"))
    )
    return camera_of_values(
        model, integer_size(content, width, height, image_size), (K[0], K[4], K[2], K[5]), distortion
    )


def _orb_slam(content: Content, image_size: Size) -> Camera:
    """ORB-SLAM2 (``Camera.fx``) and ORB-SLAM3 (``Camera1.fx``)."""
    prefix = "Camera1." if "Camera1.fx" in content else "Camera."
    kind = str(content.get("Camera.type", "PinHole"))
    model = {"pinhole": "radtan", "rectified": "pinhole", "kannalabrandt8": "fisheye"}.get(kind.lower())
    if model is None:
        raise CalibrationError(f"Camera.type is {kind!r}: use PinHole, Rectified or KannalaBrandt8")
    names = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    distortion = [number_of(content, prefix + name, default=0.0) for name in names]
    focal = tuple(number_of(content, prefix + name) for name in ("fx", "fy", "cx", "cy"))
    size = integer_size(content, "Camera.width", "Camera.height", image_size)
    return camera_of_values(model, size, focal, [] if model == "pinhole" else distortion)


def _kalibr(content: Content, image_size: Size) -> Camera:
    """A Kalibr camchain: its first camera."""
    camera = content["cam0"]
    if not isinstance(camera, dict):
        raise CalibrationError("cam0 is not a camera: expected intrinsics, resolution and so on in it")
    return _with_readout(camera, _sensor(camera, image_size, "cam0: "))


def _sensor(content: Content, image_size: Size, where: str = "") -> Camera:
    """One camera of Kalibr, or EuRoC's ``sensor.yaml``: ``intrinsics: [fu, fv, cu, cv]``."""
    projection = str(content.get("camera_model", "pinhole")).lower()
    if projection not in _KALIBR:
        raise CalibrationError(f"{where}camera_model is {projection!r}: use one of {', '.join(_KALIBR)}")
    names = _KALIBR[projection].split()
    intrinsics = numbers_of(content, "intrinsics")
    if len(intrinsics) != len(names):
        raise CalibrationError(f"{where}intrinsics: expected [{', '.join(names)}], found {len(intrinsics)} numbers")
    key = "distortion_coeffs" if "distortion_coeffs" in content else "distortion_coefficients"
    bent, coefficients = _model(content, "distortion_model"), numbers_of(content, key, default=[])
    size = image_size
    if "resolution" in content:
        resolution = numbers_of(content, "resolution")
        if len(resolution) != 2:
            raise CalibrationError(f"{where}resolution: expected [width, height]")
        size = integer_size({"width": resolution[0], "height": resolution[1]}, "width", "height", None)
    if size is None:
        raise CalibrationError(f"{where}resolution is missing")
    *shape, fx, fy, cx, cy = intrinsics
    focal = fx, fy, cx, cy
    if projection == "pinhole":
        return camera_of_values(bent, size, focal, coefficients)
    allowed = ("pinhole", "radtan") if projection == "omni" else ("pinhole",)
    if bent not in allowed or len(coefficients) > 4 or (bent == "pinhole" and any(coefficients)):
        raise CalibrationError(
            f"{where}distortion_model of a camera_model {projection} is {content.get('distortion_model')!r} with "
            f"{len(coefficients)} coefficients: use {'radtan with 4 or none' if projection == 'omni' else 'none'}"
        )
    k = [*shape, *coefficients] if any(coefficients) else shape
    return camera_of_values(model_named(projection, "camera_model"), size, focal, k)


def _basalt(content: Content, image_size: Size) -> Camera:
    """The JSON of Basalt: its first camera."""
    value = mapping_of(content, "value0", "intrinsics and resolution")
    cameras, sizes = value.get("intrinsics"), value.get("resolution")
    if not isinstance(cameras, list) or not cameras or not isinstance(cameras[0], dict):
        raise CalibrationError("value0: intrinsics is no list of cameras")
    kind = str(cameras[0].get("camera_type"))
    if kind not in _BASALT:
        raise CalibrationError(f"camera_type is {kind[:40]!r}: use one of {', '.join(_BASALT)}")
    model, names = _BASALT[kind]
    values = mapping_of(cameras[0], "intrinsics", "fx, fy, cx, cy and so on")
    focal = tuple(number_of(values, name) for name in ("fx", "fy", "cx", "cy"))
    size = image_size
    if isinstance(sizes, list) and sizes:
        pair = numbers_of({"resolution": sizes[0]}, "resolution")
        if len(pair) != 2:
            raise CalibrationError("resolution: expected [width, height] of each camera")
        size = integer_size({"width": pair[0], "height": pair[1]}, "width", "height", None)
    if size is None:
        raise CalibrationError("resolution is missing")
    k = [number_of(values, name) for name in names.split()]
    return camera_of_values(model, size, focal, [*k, 1.0] if kind == "ucm" else k)


def _camodocal(content: Content, image_size: Size) -> Camera:
    """The YAML of camodocal, as in VINS-Mono and VINS-Fusion."""
    kind = str(content["model_type"]).upper()
    if kind not in _CAMODOCAL:
        raise CalibrationError(f"model_type is {kind[:40]!r}: use one of {', '.join(_CAMODOCAL)}")
    model, focal_names = _CAMODOCAL[kind]
    size = integer_size(content, "image_width", "image_height", image_size)
    projection = mapping_of(content, "projection_parameters", "focal lengths and principal point")
    focal = tuple(number_of(projection, name) for name in focal_names.split())
    if model == "fisheye":
        return camera_of_values(model, size, focal, [number_of(projection, f"k{i}") for i in range(2, 6)])
    bent = mapping_of(content, "distortion_parameters", "k1, k2, p1, p2")
    k = [number_of(bent, name) for name in ("k1", "k2", "p1", "p2")]
    if model == "omni":
        k = [number_of(mapping_of(content, "mirror_parameters", "xi"), "xi"), *k]
    return camera_of_values(model, size, focal, k)


def _with_readout(content: Content, camera: Camera) -> Camera:
    """The camera with the readout of its rolling shutter, where the file states it.

    It is ``readout_ms`` for all rows, with ``readout_direction``, or ``line_delay`` of Kalibr: seconds for each row.
    """
    direction = str(content.get("readout_direction", camera.readout_direction))
    if "readout_ms" in content:
        return replace(camera, readout_ms=number_of(content, "readout_ms"), readout_direction=direction)
    if "line_delay" in content:
        readout_ms = 1e3 * number_of(content, "line_delay") * camera.height
        return replace(camera, readout_ms=abs(readout_ms), readout_direction="up" if readout_ms < 0 else "down")
    return camera


#: Intrinsics of the camera models of Kalibr.
_KALIBR = {
    "pinhole": "fx fy cx cy",
    "omni": "xi fx fy cx cy",
    "ds": "xi alpha fx fy cx cy",
    "eucm": "alpha beta fx fy cx cy",
}
#: Model and names of the coefficients of the camera types of Basalt; its unified model is EUCM with a beta of 1.
_BASALT = {
    "ds": ("double-sphere", "xi alpha"),
    "eucm": ("eucm", "alpha beta"),
    "ucm": ("eucm", "alpha"),
    "kb4": ("fisheye", "k1 k2 k3 k4"),
    "fov": ("fov", "w"),
    "pinhole": ("pinhole", ""),
    "pinhole-radtan8": ("radtan", "k1 k2 p1 p2 k3 k4 k5 k6"),
}
#: Model and names of focal lengths and principal point of the camera types of camodocal.
_CAMODOCAL = {
    "PINHOLE": ("radtan", "fx fy cx cy"),
    "KANNALA_BRANDT": ("fisheye", "mu mv u0 v0"),
    "MEI": ("omni", "gamma1 gamma2 u0 v0"),
}

# The keys of each format, any of which identifies it, and its parser. The first format that fits is taken.
_FORMATS: tuple[tuple[tuple[str, ...], Callable[[Content, Size], Camera]], ...] = (
    (("cam0",), _kalibr),
    (("value0",), _basalt),
    (("model_type",), _camodocal),
    (("Camera.fx", "Camera1.fx"), _orb_slam),
    (("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1", "K1"), _opencv),
    (("intrinsics",), _sensor),
    (("fx", "fy", "cx", "cy", "model", "distortion_model"), _own),
)


def _first(content: Content, *names: str) -> str:
    return next(name for name in names if name in content)


def _model(content: Content, *keys: str) -> str:
    """The model under the first key that is present; ``pinhole`` if none is."""
    key = next((key for key in keys if content.get(key) is not None), None)
    return "pinhole" if key is None else model_named(content[key], key)
