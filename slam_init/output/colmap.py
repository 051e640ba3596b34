"""Writes the initial map as a COLMAP model in text format."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from slam_init.errors import plain_line
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap

__all__ = ["colmap_model", "numbers_text"]


def colmap_model(map_: InitialMap) -> tuple[str, str, str]:
    """Write a map as a COLMAP text model of the original images.

    In COLMAP the centre of the first pixel is at (0.5, 0.5), and in this project at (0, 0). Therefore half a pixel is
    added to the principal point and to each observation. Ids begin at 1: images in the order of the keyframes, points
    in the order of the landmarks.

    Parameters
    ----------
    map_ : InitialMap
        Its camera is that of the original images, with the adjusted focal length.

    Returns
    -------
    cameras, images, points : str
        Contents of ``cameras.txt``, ``images.txt``, ``points3D.txt``.
    """
    camera = map_.camera
    model, parameters = _colmap_camera(camera)
    cameras = (
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"1 {model} {camera.width} {camera.height} {numbers_text(parameters)}\n"
    )

    images = [
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "# X, Y, POINT3D_ID for each of its points",
    ]
    errors_px = np.zeros(len(map_.observation_landmarks))
    positions = np.zeros(len(map_.observation_landmarks), int)  # of an observation among those of its image
    for k, keyframe in enumerate(map_.keyframes):
        rows = np.flatnonzero(map_.observation_keyframes == k)
        landmarks, pixels = map_.observation_landmarks[rows], map_.observation_pixels[rows]
        cam_from_world = keyframe.world_from_cam.inverse()
        projected = camera.project(cam_from_world.apply(map_.points[landmarks]))
        errors_px[rows] = np.linalg.norm(projected - pixels, axis=1)
        positions[rows] = np.arange(len(rows))
        pose = numbers_text([*cam_from_world.q_wxyz, *cam_from_world.t])
        # A line break in the name of a file would be a line break of the table.
        name = re.sub("[\r\n]", _escaped, keyframe.name)
        images.append(f"{k + 1} {pose} 1 {name}")
        images.append(
            " ".join(f"{numbers_text(pixel)} {i + 1}" for pixel, i in zip(pixels + 0.5, landmarks, strict=True))
        )

    points = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    order = np.argsort(map_.observation_landmarks, kind="stable")
    starts = np.searchsorted(map_.observation_landmarks[order], np.arange(len(map_.points) + 1))
    for i, (xyz, rgb) in enumerate(zip(map_.points, map_.colors, strict=True)):
        rows = order[starts[i] : starts[i + 1]]
        track = " ".join(f"{map_.observation_keyframes[j] + 1} {positions[j]}" for j in rows)
        error = numbers_text([float(np.mean(errors_px[rows]))])
        points.append(f"{i + 1} {numbers_text(xyz)} {' '.join(map(str, rgb))} {error} {track}")
    return cameras, "\n".join(images) + "\n", "\n".join(points) + "\n"


def _escaped(found: re.Match[str]) -> str:
    return plain_line(found[0])


def _colmap_camera(camera: Camera) -> tuple[str, list[float]]:
    """Return COLMAP's name and parameters of a camera."""
    centre = [camera.cx + 0.5, camera.cy + 0.5]
    parameters = [camera.fx, camera.fy, *centre, *camera.distortion]
    if camera.model == "pinhole":
        return "PINHOLE", parameters
    if camera.model == "fisheye":
        return "OPENCV_FISHEYE", parameters
    if len(camera.distortion) == 5 and camera.distortion[4] != 0:
        # k4, k5, k6: the denominator of the rational model.
        return "FULL_OPENCV", [*parameters, 0.0, 0.0, 0.0]
    return "OPENCV", parameters[:8]


def numbers_text(values: Sequence[float] | Floats) -> str:
    """Write numbers, separated by spaces.

    Parameters
    ----------
    values : sequence of float, or (N,) float

    Returns
    -------
    str
        Twelve significant digits each. For pixels of any image size this is a billionth of a pixel.
    """
    return " ".join(f"{value:.12g}" for value in values)
