"""Folders of neural rendering: ``transforms.json`` (nerfstudio, instant-ngp, Blender), ``poses_bounds.npy`` (LLFF).

``transforms.json`` states for each image ``file_path`` and ``transform_matrix``, world_from_cam of an OpenGL camera
(x right, y up, z backward), and the calibration for all images or for each one: ``fl_x``, ``fl_y`` or
``camera_angle_x``, ``cx``, ``cy``, ``w``, ``h``, ``k1`` to ``k4``, ``p1``, ``p2``. As in COLMAP, from which most of
these files are made, pixel centres lie at .5.

``poses_bounds.npy`` has a row of 17 numbers for each image in the order of the names: a matrix of 3x5, which is
``[R | t | (height, width, focal length)]``, and two depths. The columns of R are the camera axes x down, y right,
z backward.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slam_init.datasets.bounded import JsonObject, json_array, json_number, read_json, read_npy
from slam_init.datasets.folder import find_images
from slam_init.datasets.image_files import IMAGE_SUFFIXES, ImageFileSource, read_image
from slam_init.datasets.posed_images import PosedImage, from_opengl, posed_source
from slam_init.datasets.text import pose_from_matrix
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

#: Names of the index; the first that exists is read. The second is that of Blender's synthetic scenes.
TRANSFORMS = ("transforms.json", "transforms_train.json")
#: Poses of LLFF.
LLFF_FILE = "poses_bounds.npy"

_INTRINSICS = ("fl_x", "fl_y", "camera_angle_x", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2")
_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")

# Coordinates along the axes of an LLFF camera (down, right, backward) of those of this project (right, down, forward).
_LLFF_FROM_CAM = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Images of LLFF are reduced to whole pixels, so that the factors of width and height differ a little.
_MAX_ASPECT_CHANGE = 0.01


def open_transforms(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a folder with a ``transforms.json``."""
    folder = Path(folder)
    path = next((folder / name for name in TRANSFORMS if (folder / name).is_file()), None)
    if path is None:
        raise SourceError(f"{folder}: holds no {TRANSFORMS[0]}")
    content = read_json(path, folder, "a list of posed images")
    images = list(_transforms(path, folder, content))
    return posed_source(folder.resolve().name, "transforms", images, folder)


def _transforms(path: Path, folder: Path, content: JsonObject) -> Iterator[PosedImage]:
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        raise SourceError(f"{path}: frames is missing or empty: expected a list of images")
    size: tuple[int, int] | None = None
    cameras: dict[str, Camera | None] = {}  # by their stated values: most files state one
    for number, frame in enumerate(frames):
        place = f"{path}: frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise SourceError(f"{place}: file_path is missing")
        image = _image_path(folder, frame["file_path"])
        matrix = json_array(place, frame.get("transform_matrix"), (-1, 4), "transform_matrix")
        if len(matrix) not in (3, 4):
            raise SourceError(f"{place}: transform_matrix is not an array of 4x4 finite numbers")
        stated = {key: frame.get(key, content.get(key)) for key in _INTRINSICS}
        model = frame.get("camera_model", content.get("camera_model", "OPENCV"))
        key = repr((stated, model))
        if key not in cameras:
            if size is None and (stated["w"] is None or stated["h"] is None) and image.is_file():
                height, width = read_image(image, folder).shape[:2]
                size = width, height
            given: JsonObject = {name: value for name, value in stated.items() if value is not None}
            cameras[key] = _transforms_camera(place, given, str(model), bool(content.get("is_fisheye")), size)
        yield PosedImage(image, from_opengl(pose_from_matrix(place, matrix)), cameras[key])


def _image_path(folder: Path, text: str) -> Path:
    """The file of an image; Blender's scenes name it without its suffix."""
    path = folder / text
    return path if path.suffix.lower() in IMAGE_SUFFIXES else path.with_name(path.name + ".png")


def _transforms_camera(
    place: str, stated: JsonObject, model: str, fisheye: bool, size: tuple[int, int] | None
) -> Camera | None:
    """The camera of a frame; None where the file states no focal length."""
    if "fl_x" not in stated and "camera_angle_x" not in stated:
        return None
    fisheye = fisheye or model == "OPENCV_FISHEYE"
    if not fisheye and model.upper() not in _PERSPECTIVE:
        raise CalibrationError(f"{place}: camera_model {model[:40]!r} is not supported: use OPENCV or OPENCV_FISHEYE")
    if size is None and not {"w", "h"} <= stated.keys():
        return None  # the image is not in the folder either
    width, height = (
        json_number(place, stated, key, None if size is None else size[i]) for i, key in enumerate(("w", "h"))
    )
    if width != round(width) or height != round(height):
        raise CalibrationError(f"{place}: w and h are {width:g} and {height:g}: expected whole pixels")
    if "fl_x" in stated:
        fx = json_number(place, stated, "fl_x")
    else:
        angle = json_number(place, stated, "camera_angle_x")
        if not 0 < angle < math.pi:
            raise CalibrationError(f"{place}: camera_angle_x is {angle:g}: expected radians between 0 and pi")
        fx = 0.5 * width / math.tan(0.5 * angle)
    fy = json_number(place, stated, "fl_y", fx)
    cx, cy = json_number(place, stated, "cx", width / 2) - 0.5, json_number(place, stated, "cy", height / 2) - 0.5
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    distortion = [json_number(place, stated, name, 0.0) for name in names]
    if not fisheye and json_number(place, stated, "k4", 0.0) != 0:
        raise CalibrationError(f"{place}: k4 is not supported for a perspective camera: use k1, k2, k3, p1, p2")
    kind = "fisheye" if fisheye else ("radtan" if any(distortion) else "pinhole")
    if not fisheye and distortion[4] == 0:
        del distortion[4]
    given = () if kind == "pinhole" else tuple(distortion)
    try:
        return Camera(kind, round(width), round(height), fx, fy, cx, cy, given)
    except CalibrationError as error:
        raise CalibrationError(f"{place}: {error}") from None


def open_llff(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a folder with ``poses_bounds.npy`` and ``images``."""
    folder = Path(folder)
    path = folder / LLFF_FILE
    rows = np.asarray(read_npy(path, folder, "poses of LLFF"))
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind not in "iuf" or not np.isfinite(rows).all():
        raise SourceError(f"{path}: is an array of {rows.shape}: expected a row of 17 finite numbers for each image")
    paths = find_images(folder)
    if len(paths) != len(rows) or not paths:
        raise SourceError(f"{path}: {len(rows)} poses for {len(paths)} images in {folder / 'images'}")
    height, width = read_image(paths[0], folder).shape[:2]
    images = []
    for number, (image, row) in enumerate(zip(paths, rows.astype(float), strict=True)):
        matrix: Floats = row[:15].reshape(3, 5)
        place = f"{path}: pose {number}"
        R = matrix[:, :3] @ _LLFF_FROM_CAM
        pose = pose_from_matrix(place, np.column_stack([R, matrix[:, 3]]))
        images.append(PosedImage(image, pose, _llff_camera(place, matrix[:, 4], (width, height))))
    return posed_source(folder.resolve().name, "llff", images, folder)


def _llff_camera(place: str, stated: Floats, size: tuple[int, int]) -> Camera:
    height, width, focal = (float(value) for value in stated)
    if not (width > 0 and height > 0):
        raise CalibrationError(f"{place}: the image size is {width:g}x{height:g}: both sides must be positive")
    factor = size[0] / width
    if abs(factor * height / size[1] - 1) > _MAX_ASPECT_CHANGE:
        raise CalibrationError(
            f"{place}: the poses are for {width:g}x{height:g} images, but the images are {size[0]}x{size[1]}: "
            "give images that are reduced alike in both directions"
        )
    try:
        return Camera("pinhole", *size, factor * focal, factor * focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
    except CalibrationError as error:
        raise CalibrationError(f"{place}: {error}") from None
