"""KITTI-360 sequences: the rectified images of the two perspective cameras.

* ``data_2d_raw/SEQUENCE/image_00/data_rect`` (or ``image_01``) holds the images, whose names are frame numbers;
  ``image_00/timestamps.txt`` has the date and time of each frame.
* ``calibration/perspective.txt`` holds the projection matrices ``P_rect_00`` and ``P_rect_01``, ``K [I | t]``.
* ``data_poses/SEQUENCE/cam0_to_world.txt`` holds a frame number and the matrix world_from_cam0 of 4x4 (or 3x4) numbers,
  for the rectified camera. Frames of a car at rest have no pose.

The last two folders stand beside ``data_2d_raw``, or in the folder of the sequence.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, list_images, read_image, stored_camera
from slam_init.datasets.kitti import read_projection
from slam_init.datasets.stamps import image_times
from slam_init.datasets.text import numbers, pose_from_matrix, read_rows, trajectory
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose, Trajectory

# Where timestamps.txt is missing.
_NOMINAL_RATE_HZ = 10.0


def find_kitti360_images(folder: str | os.PathLike[str]) -> Path | None:
    """Find the image folder of a sequence.

    * ``folder``: The folder of a sequence, or ``image_00`` or ``image_01`` in it.
    """
    folder = Path(folder)
    if (folder / "data_rect").is_dir() and folder.resolve().name in ("image_00", "image_01"):
        return folder.resolve() / "data_rect"
    found = (folder / name / "data_rect" for name in ("image_00", "image_01"))
    return next((images for images in found if images.is_dir()), None)


def open_kitti360(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a KITTI-360 sequence.

    * ``folder``: The folder of the sequence, or one of its two perspective cameras.
    """
    images = find_kitti360_images(folder)
    if images is None:
        raise SourceError(f"{folder}: holds no image_00/data_rect")
    images = images.resolve()
    sequence = images.parent.parent
    beside = sequence.parent.parent  # of data_2d_raw
    paths = list_images(images)
    if not paths or not all(path.stem.isascii() and path.stem.isdecimal() for path in paths):
        raise SourceError(f"{images}: holds no images, or some whose names are no frame numbers")
    frames = [int(path.stem) for path in paths]
    timestamps_s, notes = _times(images.parent / "timestamps.txt", sequence, frames)
    camera = stored_camera(sequence, paths[0])
    cam_from_cam0 = Pose.identity()
    number = images.parent.name[-2:]
    calibration = _first_of(sequence / "calibration" / "perspective.txt", beside / "calibration" / "perspective.txt")
    if calibration is not None:
        projection = read_projection(calibration, calibration.parent.parent, f"P_rect_{number}")
        K = projection[:, :3]
        height, width = read_image(paths[0], sequence).shape[:2]
        focal = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
        camera = camera or Camera("pinhole", width, height, *focal)
        cam_from_cam0 = Pose(np.eye(3), np.asarray(np.linalg.solve(K, projection[:, 3]), float))
    name = "cam0_to_world.txt"
    poses = _first_of(sequence / name, beside / "data_poses" / sequence.name / name)
    truth = None
    if poses is not None:
        root = sequence if poses.parent == sequence else beside
        truth = _read_truth(poses, root, dict(zip(frames, timestamps_s.tolist(), strict=True)), cam_from_cam0.inverse())
    name = f"{sequence.name}/{images.parent.name}"
    return ImageFileSource(name, "kitti360", tuple(paths), timestamps_s, camera, truth, notes, sequence)


def _first_of(*candidates: Path) -> Path | None:
    return next((path for path in candidates if path.is_file()), None)


def _times(path: Path, root: Path, frames: list[int]) -> tuple[Floats, tuple[str, ...]]:
    """Seconds since the epoch of each frame, and notes."""
    if not path.exists():
        return np.array(frames) / _NOMINAL_RATE_HZ, ()
    rows = list(read_rows(path, root))
    if frames[-1] >= len(rows):
        raise SourceError(f"{path}: {len(rows)} times, but there is an image of frame {frames[-1]}")
    stamps = []
    for place, text in (rows[frame] for frame in frames):
        try:
            # The format has nine decimals, of which datetime keeps six.
            stamps.append(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp())
        except ValueError:
            raise SourceError(f"{place}: expected a date and time, found {text[:40]!r}") from None
    return image_times(stamps, [rows[frame][0] for frame in frames])


def _read_truth(path: Path, root: Path, times_s: dict[int, float], cam0_from_cam: Pose) -> Trajectory | None:
    stamped = []
    for row in read_rows(path, root):
        fields = row[1].split()
        count = 17 if len(fields) >= 17 else 13
        frame, *values = numbers(row, fields, count, "a frame number and a pose of 16 or 12 numbers")
        time_s = times_s.get(round(frame))
        if time_s is not None:
            world_from_cam0 = pose_from_matrix(row[0], np.array(values[:12]).reshape(3, 4))
            stamped.append((time_s, world_from_cam0 @ cam0_from_cam))
    return trajectory(stamped)
