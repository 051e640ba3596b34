"""KITTI odometry sequences.

* ``sequences/NN/image_0`` (to ``image_3``) holds the images, ``sequences/NN/times.txt`` their time stamps.
* ``sequences/NN/calib.txt`` holds the projection matrices ``P0`` to ``P3``. With ``P_i = K [I | t]``, the pose
  ``cam_i_from_cam0`` is the translation t.
* ``poses/NN.txt`` beside ``sequences``, or ``poses.txt`` in the sequence, holds 3x4 matrices world_from_cam0.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, list_images, read_image, stored_camera
from slam_init.datasets.stamps import image_times, stamp_of
from slam_init.datasets.text import numbers, pose_from_matrix, read_rows, trajectory
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose, Trajectory

# Frame rate where times.txt is missing: the cameras were triggered at 10 Hz.
_NOMINAL_RATE_HZ = 10.0


def find_kitti_images(folder: str | os.PathLike[str]) -> Path | None:
    """Find the image folder of a sequence: the left grey camera, or else the left colour camera."""
    folder = Path(folder)
    for name in ("image_0", "image_2"):
        if (folder / name).is_dir():
            return folder / name
    resolved = folder.resolve()
    beside = any((resolved.parent / name).is_file() for name in ("calib.txt", "times.txt"))
    return resolved if beside and re.fullmatch(r"image_[0-3]", resolved.name) else None


def open_kitti(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a KITTI odometry sequence."""
    found = find_kitti_images(folder)
    if found is None:
        raise SourceError(f"{folder}: no image_0 or image_2 in it")
    images = found.resolve()
    sequence = images.parent
    if found.parent == Path(folder):  # the sequence is named, and not its images
        check_inside(found, folder)
    paths = list_images(images)
    if not paths:
        raise SourceError(f"{images}: holds no image")
    times = sequence / "times.txt"
    notes: tuple[str, ...] = ()
    if times.exists():
        rows = list(read_rows(times, sequence))
        if len(rows) != len(paths):
            raise SourceError(f"{times}: {len(rows)} times for {len(paths)} images in {images.name}")
        stamps = [stamp_of(row, row[1].split(), "a time in seconds") for row in rows]
        timestamps_s, notes = image_times(stamps, [place for place, _ in rows])
    else:
        timestamps_s = np.arange(len(paths)) / _NOMINAL_RATE_HZ
    camera = stored_camera(sequence, paths[0])
    cam_from_cam0 = Pose.identity()
    if (sequence / "calib.txt").exists():
        projection = read_projection(sequence / "calib.txt", sequence, f"P{images.name[-1]}")
        K = projection[:, :3]
        height, width = read_image(paths[0], sequence).shape[:2]
        camera = camera or Camera(
            "pinhole", width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
        )
        cam_from_cam0 = Pose(np.eye(3), np.asarray(np.linalg.solve(K, projection[:, 3]), float))
    truth = _read_truth(sequence, timestamps_s, cam_from_cam0.inverse())
    name = f"{sequence.name}/{images.name}"
    return ImageFileSource(name, "kitti", tuple(paths), timestamps_s, camera, truth, notes, sequence)


def read_projection(path: Path, root: Path, key: str) -> Floats:
    """Read the projection matrix of one rectified camera.

    Shapes: returns (3, 4).

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    for row in read_rows(path, root):
        name, _, rest = row[1].partition(":")
        if name.strip() == key:
            values = np.array(numbers(row, rest.split(), 12, f"{key}: and 12 numbers")).reshape(3, 4)
            if not (values[0, 0] > 0 and values[1, 1] > 0 and values[2, 2] > 0):
                raise SourceError(f"{row[0]}: {key} has no positive focal length")
            K = values[:, :3]
            if K[1, 0] != 0 or K[2, 0] != 0 or K[2, 1] != 0 or np.abs(values).max() > 1e100 * K[2, 2]:
                raise SourceError(f"{row[0]}: {key} is no projection matrix [fx 0 cx, 0 fy cy, 0 0 1 | K t]")
            return np.asarray(values / values[2, 2])
    raise SourceError(f"{path}: no line {key}:")


def _read_truth(sequence: Path, timestamps_s: Floats, cam0_from_cam: Pose) -> Trajectory | None:
    candidates = (sequence.parent.parent / "poses" / f"{sequence.name}.txt", sequence / "poses.txt")
    path = next((candidate for candidate in candidates if candidate.exists()), None)
    if path is None:
        return None
    root = path.parent.parent if path == candidates[0] else sequence
    poses = [
        pose_from_matrix(row[0], np.array(numbers(row, row[1].split(), 12, "12 numbers of a 3x4 pose")).reshape(3, 4))
        for row in read_rows(path, root)
    ]
    if len(poses) != len(timestamps_s):
        raise SourceError(f"{path}: {len(poses)} poses for {len(timestamps_s)} images")
    return trajectory([(t, pose @ cam0_from_cam) for t, pose in zip(timestamps_s.tolist(), poses, strict=True)])
