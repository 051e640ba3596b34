"""Makes a camera from the model and the coefficients of a file, whose names and numbers differ between formats."""

from __future__ import annotations

import math

from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

#: Names of the models in all formats, lower case -> model of :class:`~slam_init.types.camera.Camera`. OpenCV's models
#: of 4 to 12 coefficients have one name in most formats; the coefficients tell them apart.
_MODELS = {
    "none": "pinhole",
    "": "pinhole",
    "pinhole": "pinhole",
    "radtan": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "rational": "radtan",
    "thin-prism": "radtan",
    "thin_prism": "radtan",
    "equidistant": "fisheye",
    "equi": "fisheye",
    "fisheye": "fisheye",
    "kannalabrandt8": "fisheye",
    "kannala_brandt": "fisheye",
    "kb4": "fisheye",
    "thin-prism-fisheye": "thin-prism-fisheye",
    "fov": "fov",
    "atan": "fov",
    "omni": "omni",
    "mei": "omni",
    "ds": "double-sphere",
    "double-sphere": "double-sphere",
    "double_sphere": "double-sphere",
    "eucm": "eucm",
    "equirectangular": "equirectangular",
}


def model_named(name: object, key: str) -> str:
    """Find the model of a name."""
    found = _MODELS.get(str(name).lower())
    if found is None:
        known = ", ".join(one for one in _MODELS if one)
        raise CalibrationError(f"{key} is {str(name)[:40]!r}: use one of {known}")
    return found


def camera_of_values(model: str, size: tuple[int, int], focal: tuple[float, ...], distortion: list[float]) -> Camera:
    """Make a camera. Zero coefficients of OpenCV's models are added or removed, to get the simplest model that fits."""
    k = list(distortion)
    if model == "equirectangular" and not focal:
        # The whole sphere: the centres of the first and last columns lie half a pixel before the borders.
        focal = (size[0] / (2 * math.pi), size[1] / math.pi, (size[0] - 1) / 2, (size[1] - 1) / 2)
    if model == "pinhole" and any(k):
        model = "radtan"  # files of OpenCV have this model and do not name it
    if model == "pinhole":
        k = []
    elif model == "fisheye":
        if len(k) != 4:
            raise CalibrationError(f"{len(k)} distortion coefficients for a fisheye camera: give k1, k2, k3, k4")
    elif model == "radtan":
        model, k = _simplest_opencv(k)
    fx, fy, cx, cy = focal
    return Camera(model, *size, fx, fy, cx, cy, tuple(k))


def _simplest_opencv(k: list[float]) -> tuple[str, list[float]]:
    """Model and coefficients of OpenCV's ``k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]``."""
    if any(k[12:]):
        raise CalibrationError("distortion has a tilted sensor (14 coefficients): calibrate with 12 of them or fewer")
    if any(k[8:12]):
        return "thin-prism", (k + 4 * [0.0])[:12]
    if any(k[5:8]):
        if len(k) < 8:
            raise CalibrationError(
                f"{len(k)} distortion coefficients: give 4 or 5 for radial-tangential, 8 for rational_polynomial"
            )
        return "rational", k[:8]
    k = (k[:5] + [0.0] * 4)[: max(4, min(len(k), 5))]
    if len(k) == 5 and k[4] == 0:
        k = k[:4]
    return ("radtan", k) if any(k) else ("pinhole", [])
