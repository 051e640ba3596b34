"""The camera models of COLMAP. Its pixel centres lie at .5, those of this project at integers."""

from __future__ import annotations

from collections.abc import Sequence

from slam_init.calibration.making import camera_of_values
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

#: Names of the parameters of each model. The first ones have their numbers in binary files and databases as places.
COLMAP_PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "EUCM": "fx fy cx cy alpha beta",
    "EQUIRECTANGULAR": "w h",
}
#: The models whose numbers are known: COLMAP, src/colmap/sensor/models.h.
NUMBERED = tuple(COLMAP_PARAMETERS)[:11]
#: Coefficients of each model of this project, in its order; those that a model of COLMAP lacks are 0.
_COEFFICIENTS = {
    "radtan": "k1 k2 p1 p2 k3 k4 k5 k6",
    "fisheye": "k1 k2 k3 k4",
    "thin-prism-fisheye": "k1 k2 p1 p2 k3 k4 sx1 sy1",
    "fov": "omega",
    "eucm": "alpha beta",
    "equirectangular": "",
}
_MODELS = {
    "THIN_PRISM_FISHEYE": "thin-prism-fisheye",
    "FOV": "fov",
    "EUCM": "eucm",
    "EQUIRECTANGULAR": "equirectangular",
}


def camera_of_colmap(model: str, width: int, height: int, parameters: Sequence[float]) -> Camera:
    """Convert a camera of COLMAP."""
    if model not in COLMAP_PARAMETERS:
        raise CalibrationError(f"camera model {model!r} of COLMAP: use one of {', '.join(COLMAP_PARAMETERS)}")
    names = COLMAP_PARAMETERS[model].split()
    if len(parameters) != len(names):
        raise CalibrationError(f"{model} takes {len(names)} parameters, found {len(parameters)}")
    values = dict(zip(names, parameters, strict=True))
    kind = _MODELS.get(model, "fisheye" if model.endswith("FISHEYE") else "radtan")
    focal: tuple[float, ...] = ()
    if "cx" in values:
        fx, fy = (values["f"], values["f"]) if "f" in values else (values["fx"], values["fy"])
        focal = fx, fy, values["cx"] - 0.5, values["cy"] - 0.5
    distortion = [values.get(name, 0.0) for name in _COEFFICIENTS[kind].split()]
    return camera_of_values(kind, (width, height), focal, distortion)
