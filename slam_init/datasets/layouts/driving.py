"""Sequences of vehicles: KITTI odometry and TartanAir.

**KITTI odometry**

* ``sequences/NN/image_0`` (to ``image_3``) holds the images, ``sequences/NN/times.txt`` their time stamps.
* ``sequences/NN/calib.txt`` holds the projection matrices ``P0`` to ``P3``. With ``P_i = K [I | t]``, the pose
  ``cam_i_from_cam0`` is the translation t.
* ``poses/NN.txt`` beside ``sequences``, or ``poses.txt`` in the sequence, holds 3x4 matrices world_from_cam0.

**TartanAir**

* ``image_left/*.png`` with ``pose_left.txt`` (the first version), or ``image_lcam_front`` with ``pose_lcam_front.txt``
  (the second one): a line of ``tx ty tz qx qy qz qw`` for each image.
* The axes of world and camera are north, east, down: the camera looks along x, y points to the right, z down.
* All cameras are alike: a field of view of 90 degrees across, published as f = 320, c = (320, 240) for 640x480 pixels.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam_init.calibration.files import camera_of
from slam_init.datasets.image_files import ImageFileSource, image_size, list_images, stored_camera
from slam_init.datasets.posed_images import Layout, image_sequence, with_axes
from slam_init.datasets.text import check_count, fields_of, numbers, read_poses_of, read_rows, stamp_of
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

# Frame rate where no file states times: the cameras of KITTI were triggered at 10 Hz, and TartanAir is rendered at it.
_NOMINAL_RATE_HZ = 10.0

_TARTANAIR = (("image_left", "pose_left.txt"), ("image_lcam_front", "pose_lcam_front.txt"))


def find_kitti(folder: Path) -> Path | None:
    """Find the image folder of a sequence: the left grey camera, or else the left colour camera."""
    for name in ("image_0", "image_2"):
        if (folder / name).is_dir():
            return folder / name
    resolved = folder.resolve()
    beside = any((resolved.parent / name).is_file() for name in ("calib.txt", "times.txt"))
    return resolved if beside and re.fullmatch(r"image_[0-3]", resolved.name) else None


def open_kitti(folder: Path, found: Path) -> ImageFileSource:
    """Open a KITTI odometry sequence, or the images of one of its cameras."""
    images = found.resolve()
    sequence = images.parent
    if found.parent == folder:  # the sequence is named, and not its images
        check_inside(found, folder)
    paths = list_images(images)
    times, stamps = sequence / "times.txt", []
    if times.exists():
        stamps = [(row[0], stamp_of(row, fields_of(row), "a time in seconds")) for row in read_rows(times, sequence)]
        check_count(times, stamps, "times", paths)
    camera, cam0_from_cam = None, Pose.identity()
    if (sequence / "calib.txt").exists():
        size = image_size(paths[0], sequence)
        camera, cam0_from_cam = _rectified(sequence / "calib.txt", sequence, f"P{images.name[-1]}", size)
    poses: list[Pose] = []
    beside = sequence.parent.parent
    for path, root in ((beside / "poses" / f"{sequence.name}.txt", beside), (sequence / "poses.txt", sequence)):
        if path.exists():
            poses = [pose @ cam0_from_cam for pose in read_poses_of(paths, path, root)]
            break
    camera, name = stored_camera(sequence, paths[0]) or camera, f"{sequence.name}/{images.name}"
    return image_sequence(
        "kitti", sequence, paths, name=name, stamps=stamps, rate_hz=_NOMINAL_RATE_HZ, camera=camera, poses=poses
    )


def _rectified(path: Path, root: Path, key: str, size: tuple[int, int]) -> tuple[Camera, Pose]:
    """The camera of a projection matrix ``K [I | t]``, and its pose cam0_from_cam."""
    for row in read_rows(path, root):
        name, _, rest = row[1].partition(":")
        if name.strip() == key:
            values = np.array(numbers(row, rest.split(), 12, f"{key}: and 12 numbers")).reshape(3, 4)
            if not (values[2, 2] > 0 and np.abs(values).max() <= 1e100 * values[2, 2]):
                raise SourceError(f"{row[0]}: {key} is no projection matrix [fx 0 cx, 0 fy cy, 0 0 1 | K t]")
            values = values / values[2, 2]
            width, height = size
            K = values[:, :3]
            camera = camera_of(f"{row[0]}: {key}", {"K": K.ravel().tolist(), "width": width, "height": height})
            camera = replace(camera, source="machine")
            cam_from_cam0 = Pose(np.eye(3), np.asarray(np.linalg.solve(K, values[:, 3]), float))
            return camera, cam_from_cam0.inverse()
    raise SourceError(f"{path}: no line {key}:")


def find_tartanair(folder: Path) -> tuple[Path, Path] | None:
    """Find the images and the poses of a sequence."""
    found = ((folder / images, folder / poses) for images, poses in _TARTANAIR)
    return next(((images, poses) for images, poses in found if images.is_dir() and poses.is_file()), None)


def open_tartanair(folder: Path, found: tuple[Path, Path]) -> ImageFileSource:
    """Open a TartanAir sequence."""
    paths = list_images(found[0])
    stated = read_poses_of(paths, found[1], folder, "tx ty tz qx qy qz qw")
    poses = [with_axes(pose, "forward, right, down") for pose in stated]
    width, height = image_size(paths[0], folder)
    published = Camera("pinhole", width, height, width / 2, width / 2, width / 2, height / 2, source="machine")
    camera = stored_camera(folder, paths[0]) or published
    return image_sequence("tartanair", folder, paths, rate_hz=_NOMINAL_RATE_HZ, camera=camera, poses=poses)


LAYOUTS = (
    Layout("kitti", "image_0 or image_2 (KITTI)", find_kitti, open_kitti),
    Layout("tartanair", "image_left with pose_left.txt (TartanAir)", find_tartanair, open_tartanair),
)
