"""The cameras of COLMAP: its model of a camera, or the pinhole camera that stands for one that it has no model of."""

from __future__ import annotations

import math

import numpy as np

from slam_init.types.camera import Camera

#: COLMAP's models with the same parameters in the same order.
_SAME_PARAMETERS = {"rational": "FULL_OPENCV", "thin-prism-fisheye": "THIN_PRISM_FISHEYE", "fov": "FOV", "eucm": "EUCM"}
#: Number of coefficients that COLMAP's models take, where a lens with more radial distortion has one more.
_COEFFICIENTS = {"fov": 1, "eucm": 2}


def colmap_view(camera: Camera) -> tuple[Camera, str]:
    """Choose the camera that is written.

    * Returns ``camera``: The same one, or the pinhole camera with the same pixels near the optical axis.
    """
    note = colmap_note(camera)
    if not note:
        return camera, note
    K = camera.K
    return Camera("pinhole", camera.width, camera.height, K[0, 0], K[1, 1], camera.cx, camera.cy), note


def colmap_note(camera: Camera) -> str:
    """Tell what a COLMAP model cannot say about a camera."""
    if camera.model == "equirectangular" and not _is_whole_sphere(camera):
        what = "panoramas of the whole sphere only"
    elif camera.model in ("omni", "double-sphere", "thin-prism"):
        what = f"no {camera.model} model"
    elif len(camera.distortion) > _COEFFICIENTS.get(camera.model, len(camera.distortion)):
        what = f"no {camera.model} model with more radial distortion"
    else:
        return ""
    return f"COLMAP has {what}: the observations in colmap/ are those of an undistorted PINHOLE camera"


def _is_whole_sphere(camera: Camera) -> bool:
    sphere = (camera.width / (2 * math.pi), camera.height / math.pi)
    centre = ((camera.width - 1) / 2, (camera.height - 1) / 2)
    same_scale = np.allclose((camera.fx, camera.fy), sphere, rtol=1e-4)
    return same_scale and np.allclose((camera.cx, camera.cy), centre, atol=0.1)


def colmap_camera(camera: Camera) -> tuple[str, list[float]]:
    """Find COLMAP's name and parameters of a camera."""
    centre = [camera.cx + 0.5, camera.cy + 0.5]
    parameters = [camera.fx, camera.fy, *centre, *camera.distortion]
    if camera.model == "equirectangular":
        return "EQUIRECTANGULAR", [camera.width, camera.height]
    if camera.model in _SAME_PARAMETERS:
        return _SAME_PARAMETERS[camera.model], parameters
    if camera.model == "pinhole":
        return "PINHOLE", parameters
    if camera.model == "fisheye":
        return "OPENCV_FISHEYE", parameters
    if len(camera.distortion) == 5 and camera.distortion[4] != 0:
        # k4, k5, k6: the denominator of the rational model.
        return "FULL_OPENCV", [*parameters, 0.0, 0.0, 0.0]
    return "OPENCV", parameters[:8]
