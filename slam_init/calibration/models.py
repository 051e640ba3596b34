"""The models of lenses in calibration files: their names, their coefficients, and the camera that they make."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from slam_init.calibration.values import Section
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera
from slam_init.types.lens import UNKNOWN_PRINCIPAL_SIGMA

#: Largest distance of the principal point of intrinsics without a size from the centre: four standard deviations of a
#: principal point that nobody calibrated. Where images were resized by s, it is off by (1 - s) / 2 s: they are
#: refused below 0.83 and above 1.25, and where a sixth of a side was cropped. Of the 17 calibrations of the test data
#: (EuRoC, KITTI, TUM and others) the farthest, a webcam's, is off by 0.036.
#: Class: level, over the longer side.
_MAX_CENTRE_OFFSET = 4 * UNKNOWN_PRINCIPAL_SIGMA

#: Names of the parameters of each model of COLMAP. Binary files and databases have numbers for the first ones.
COLMAP_PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy", "PINHOLE": "fx fy cx cy", "SIMPLE_RADIAL": "f cx cy k1", "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2", "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6", "FOV": "fx fy cx cy w",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1", "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 s1 s2",
    "SIMPLE_FISHEYE": "f cx cy", "FISHEYE": "fx fy cx cy", "EUCM": "fx fy cx cy alpha beta",
    "EQUIRECTANGULAR": "columns lines",
}  # fmt: skip
#: The models whose numbers are known: COLMAP, src/colmap/sensor/models.h.
NUMBERED = tuple(COLMAP_PARAMETERS)[:11]

#: Model of :class:`~slam_init.types.camera.Camera` -> its names in all formats, lower case. OpenCV's models of 4 to 12
#: coefficients have one name in most formats; the coefficients distinguish them. ``rectified`` and ``ucm`` are no
#: models of their own: a pinhole camera whose coefficients do not count, and ``eucm`` with a beta of 1.
_NAMES = {
    "pinhole": "none perspective simple_pinhole",
    "radtan": "radial_tangential radialtangential radialtangential8 plumb_bob rational rational_polynomial thin_prism "
    "pinhole_full pinhole_radtan8 simple_radial radial opencv full_opencv",
    "fisheye": "equidistant equi kannalabrandt kannalabrandt8 kannala_brandt kb4 simple_fisheye simple_radial_fisheye "
    "radial_fisheye opencv_fisheye",
    "fov": "atan", "omni": "mei", "double_sphere": "ds",
    "eucm": "", "thin_prism_fisheye": "", "equirectangular": "", "rectified": "", "ucm": "",
}  # fmt: skip
_MODELS = {"": "pinhole"} | {
    name: model.replace("_", "-") for model, names in _NAMES.items() for name in (model, *names.split())
}
#: Coefficients that a file may have by name. Those of the first row are part of the model; others are 0 if absent.
_SHAPES = {"omni": "xi", "double-sphere": "xi alpha", "eucm": "alpha beta", "ucm": "alpha"}
_COEFFICIENTS = {
    "pinhole": "k1 k2 p1 p2 k3 k4 k5 k6", "radtan": "k1 k2 p1 p2 k3 k4 k5 k6", "fisheye": "k1 k2 k3 k4",
    "thin-prism-fisheye": "k1 k2 p1 p2 k3 k4 s1 s2", "omni": "k1 k2 p1 p2", "fov": "w",
}  # fmt: skip
# Keys that state a model, without what is no letter: camera_model, Camera.type, distortionType, model_type, ...
_MODEL_KEY = re.compile("(camera|cam|distortion|lens|projection|calibration)*(model|type)+")
_FISHEYE_KEY = re.compile("(is|b)?fisheye(model)?")
_FLAGS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}


def states_model(name: str) -> bool:
    """Tell whether a key states the model of a lens."""
    letters = re.sub("[^a-z]", "", name.lower())
    return bool(_MODEL_KEY.fullmatch(letters) or _FISHEYE_KEY.fullmatch(letters))


def model_of(section: Section) -> str:
    """Find the model that a camera states. Formats state projection and distortion apart, or both under one key.

    A value that is not understood is an error under every key that states a model: a wrong lens bends the map, and
    nothing else in the file shows it.
    """
    stated: dict[str, str] = {}
    for name in filter(states_model, section.values):
        key, value = section.key(name), str(section.values[name])
        if _FISHEYE_KEY.fullmatch(re.sub("[^a-z]", "", name)):
            if value.lower() not in _FLAGS:
                raise CalibrationError(f"{key} is {value[:40]!r}: give true or false")
            model = "fisheye" if _FLAGS[value.lower()] else "pinhole"
        elif not (model := _MODELS.get(re.sub("[ -]", "_", value.strip().lower()), "")):
            known = ", ".join(one.replace("_", "-") for one in _NAMES)
            give = f"use one of {known}, or a name of theirs in docs/how-to/camera.md"
            raise CalibrationError(f"{key} is {value[:40]!r}: {give}; leave the line out if it does not state a lens")
        stated.setdefault(model, key)
    bent = {model: key for model, key in stated.items() if model != "pinhole"}
    if set(bent) == {"omni", "radtan"}:
        return "omni"
    if len(bent) > 1:
        both = " and ".join(f"{key} states {model}" for model, key in bent.items())
        raise CalibrationError(f"{both}: no lens is both, so leave one of the lines out")
    return next(iter(bent), "pinhole")


def shape_names(model: str) -> list[str]:
    """The coefficients that are part of a model, as in Kalibr, which writes them before the focal lengths."""
    return _SHAPES.get(model, "").split()


def named_coefficients(section: Section, model: str) -> list[float]:
    """Read the coefficients that a camera states by name, one key for each."""
    shape = [section.number(name) for name in shape_names(model)]
    names = _COEFFICIENTS.get(model, "").split()
    # K1 may be the matrix of the first of two cameras.
    if any(not isinstance(section.values.get(name, []), list | dict) for name in names):
        return shape + [section.number(name, 0.0) for name in names]
    return shape


def camera_of_values(model: str, size: tuple[int, int], focal: Sequence[float], distortion: list[float]) -> Camera:
    """Make a camera. Zero coefficients of OpenCV's models are added or removed, to get the simplest model that fits."""
    k = list(distortion)
    if model == "equirectangular" and not focal:
        # The whole sphere: the centres of the first and last columns lie half a pixel before the borders.
        focal = (size[0] / (2 * math.pi), size[1] / math.pi, (size[0] - 1) / 2, (size[1] - 1) / 2)
    if model == "rectified":
        model, k = "pinhole", []
    elif model == "fisheye":
        k = k if any(k[4:]) else k[:4]  # drivers pad the list to five
    elif model in ("pinhole", "radtan"):  # files of OpenCV have coefficients and do not name the model
        model, k = _simplest_opencv(k)
    elif model == "ucm":
        model, k = "eucm", [*k, 1.0]
    elif (shape := len(shape_names(model))) and not any(k[shape:]):
        k = k[:shape]
    fx, fy, cx, cy = focal
    return Camera(model, *size, fx, fy, cx, cy, tuple(k))


def check_centre(camera: Camera) -> None:
    """Refuse intrinsics without a size whose principal point is far from the centre: they are of other images."""
    width, height = camera.width, camera.height
    off = max(abs(camera.cx - (width - 1) / 2), abs(camera.cy - (height - 1) / 2)) / max(width, height)
    if off > _MAX_CENTRE_OFFSET:
        likely = f"{round(2 * camera.cx + 1)}x{round(2 * camera.cy + 1)}"
        problem = f"the principal point ({camera.cx:g}, {camera.cy:g}) is that of images of about {likely}"
        give = "scale it (resized), subtract the corner (cropped), or state the size (from_K or in the file)"
        raise CalibrationError(f"{problem}, and these are {width}x{height}: {give}")


def _simplest_opencv(k: list[float]) -> tuple[str, list[float]]:
    """Model and coefficients of OpenCV's ``k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]``."""
    if any(k[12:]):
        raise CalibrationError("distortion has a tilted sensor (14 coefficients): calibrate with 12 of them or fewer")
    if any(k[8:12]):
        return "thin-prism", (k + 4 * [0.0])[:12]
    if any(k[5:8]):
        return "rational", k[:8]
    k = (k[:5] + [0.0] * 4)[: max(4, min(len(k), 5))]
    if len(k) == 5 and k[4] == 0:
        k = k[:4]
    return ("radtan", k) if any(k) else ("pinhole", [])
