"""The cameras of a map as ``transforms.json``, as nerfstudio and instant-ngp read it.

A pose in this file is ``world_from_cam`` of a camera in the axes of OpenGL: x right, y up, z backward. The world is
that of the map. In nerfstudio the centre of the first pixel is at (0.5, 0.5), as in COLMAP. The names of the images are
relative to a folder ``images`` beside the file. ``ply_file_path`` names the landmarks, with which Gaussian splatting
starts.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from slam_init.output.plain_json import Json
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

#: y and z point the other way.
_FLIP = np.diag([1.0, -1.0, -1.0])


def opengl_matrix(world_from_cam: Pose) -> Floats:
    """Convert a pose to the axes of OpenGL: returns (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = world_from_cam.R @ _FLIP, world_from_cam.t
    return matrix


def transforms_text(map_: InitialMap, located: Sequence[Keyframe] = (), points: str = "map.ply") -> str | None:
    """Write the keyframes, and the frames that were located after the initialization.

    * ``points``: Name of the file of the landmarks.
    * Returns: JSON with a final newline; None where nerfstudio has no such camera model.
    """
    camera = _camera(map_.camera)
    if camera is None:
        return None
    keyframes = sorted({keyframe.frame: keyframe for keyframe in (*located, *map_.keyframes)}.items())
    frames: list[Json] = [
        {"file_path": f"images/{keyframe.name}", "transform_matrix": opengl_matrix(keyframe.world_from_cam).tolist()}
        for _, keyframe in keyframes
    ]
    return json.dumps(camera | {"ply_file_path": points, "frames": frames}, indent=1) + "\n"


def _camera(camera: Camera) -> dict[str, Json] | None:
    """The intrinsics by nerfstudio's names; None for other models than those of OpenCV."""
    shared: dict[str, Json] = {
        "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
    }  # fmt: skip
    if camera.model == "fisheye":
        names: tuple[str, ...] = ("k1", "k2", "k3", "k4")
        model = "OPENCV_FISHEYE"
        shared["is_fisheye"] = True  # instant-ngp reads no camera_model
    elif camera.model in ("pinhole", "radtan"):
        names, model = ("k1", "k2", "p1", "p2", "k3")[: len(camera.distortion)], "OPENCV"
    else:
        return None
    return {"camera_model": model} | shared | dict(zip(names, camera.distortion, strict=True))
