"""TartanAir sequences.

* ``image_left/*.png`` with ``pose_left.txt`` (the first version), or ``image_lcam_front`` with ``pose_lcam_front.txt``
  (the second one): a line of ``tx ty tz qx qy qz qw`` for each image.
* The axes of world and camera are north, east, down: the camera looks along x, y points to the right, z down.
* All cameras are alike: a field of view of 90 degrees across, published as f = 320, c = (320, 240) for 640x480 pixels.
* There are no time stamps: the nominal rate is 10 Hz.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, list_images, read_image, stored_camera
from slam_init.datasets.text import numbers, pose_from_quaternion, read_rows, trajectory
from slam_init.errors import SourceError
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

_CAMERAS = (("image_left", "pose_left.txt"), ("image_lcam_front", "pose_lcam_front.txt"))
_NOMINAL_RATE_HZ = 10.0

#: Coordinates along (forward, right, down) of those of this project (right, down, forward).
_NED_FROM_CAM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def find_tartanair(folder: str | os.PathLike[str]) -> tuple[Path, Path] | None:
    """Find the images and the poses of a sequence.

    Shapes: returns (Path, Path).

    * Returns: Image folder and pose file; None if this is not a TartanAir folder.
    """
    folder = Path(folder)
    found = ((folder / images, folder / poses) for images, poses in _CAMERAS)
    return next(((images, poses) for images, poses in found if images.is_dir() and poses.is_file()), None)


def open_tartanair(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a TartanAir sequence."""
    folder = Path(folder)
    found = find_tartanair(folder)
    if found is None:
        raise SourceError(f"{folder}: holds no {_CAMERAS[0][0]} with {_CAMERAS[0][1]}")
    paths = list_images(found[0])
    if not paths:
        raise SourceError(f"{found[0]}: holds no image")
    poses = []
    for row in read_rows(found[1], folder):
        tx, ty, tz, qx, qy, qz, qw = numbers(row, row[1].split(), 7, "tx ty tz qx qy qz qw")
        world_from_ned = pose_from_quaternion(row, [tx, ty, tz], [qw, qx, qy, qz])
        poses.append(Pose(world_from_ned.R @ _NED_FROM_CAM, world_from_ned.t))
    if len(poses) != len(paths):
        raise SourceError(f"{found[1]}: {len(poses)} poses for {len(paths)} images in {found[0].name}")
    height, width = read_image(paths[0], folder).shape[:2]
    focal = width / 2
    camera = stored_camera(folder, paths[0]) or Camera("pinhole", width, height, focal, focal, width / 2, height / 2)
    timestamps_s = np.arange(len(paths)) / _NOMINAL_RATE_HZ
    truth = trajectory(list(zip(timestamps_s.tolist(), poses, strict=True)))
    return ImageFileSource(folder.resolve().name, "tartanair", tuple(paths), timestamps_s, camera, truth, root=folder)
