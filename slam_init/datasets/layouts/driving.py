"""Sequences of vehicles: KITTI odometry, KITTI-360, 4Seasons and TartanAir.

**KITTI odometry**

* ``sequences/NN/image_0`` (to ``image_3``) holds the images, ``sequences/NN/times.txt`` their time stamps.
* ``sequences/NN/calib.txt`` holds the projection matrices ``P0`` to ``P3``. With ``P_i = K [I | t]``, the pose
  ``cam_i_from_cam0`` is the translation t.
* ``poses/NN.txt`` beside ``sequences``, or ``poses.txt`` in the sequence, holds 3x4 matrices world_from_cam0.

**KITTI-360**, the rectified images of the two perspective cameras

* ``data_2d_raw/SEQUENCE/image_00/data_rect`` (or ``image_01``) holds the images, whose names are frame numbers;
  ``image_00/timestamps.txt`` has the date and time of each frame.
* ``calibration/perspective.txt`` holds the projection matrices ``P_rect_00`` and ``P_rect_01``, ``K [I | t]``.
* ``data_poses/SEQUENCE/cam0_to_world.txt`` holds a frame number and the matrix world_from_cam0 of 4x4 (or 3x4) numbers,
  for the rectified camera. Frames of a car at rest have no pose.
* The last two folders stand beside ``data_2d_raw``, or in the folder of the sequence.

**4Seasons**

* ``undistorted_images/cam0`` (or ``distorted_images/cam0``) holds images whose names are nanoseconds.
* ``calibration/undistorted_calib_0.txt`` (``calib_0.txt``), in the folder of the recording or beside it: a line
  ``Pinhole`` or ``Equidistant`` with ``fx fy cx cy`` and four coefficients, and a line with width and height.
* ``GNSSPoses.txt``, the poses of the keyframes after the fusion with satellite positions:
  ``nanoseconds,tx,ty,tz,qx,qy,qz,qw,scale,...``. Where it is missing, ``result.txt``: the visual-inertial odometry of
  all frames in the format of TUM RGB-D. Both are world_from_cam with the axes of this project.

**TartanAir**

* ``image_left/*.png`` with ``pose_left.txt`` (the first version), or ``image_lcam_front`` with ``pose_lcam_front.txt``
  (the second one): a line of ``tx ty tz qx qy qz qw`` for each image.
* The axes of world and camera are north, east, down: the camera looks along x, y points to the right, z down.
* All cameras are alike: a field of view of 90 degrees across, published as f = 320, c = (320, 240) for 640x480 pixels.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, image_size, images_of, list_images, stored_camera
from slam_init.datasets.posed_images import Layout, image_sequence, with_axes
from slam_init.datasets.stamps import stamp_of
from slam_init.datasets.text import (
    check_count,
    fields_of,
    numbers,
    pinhole,
    pose_from_matrix,
    read_poses,
    read_rows,
    read_trajectory,
)
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose
from slam_init.types.time_stamps import TimeUnit

# Frame rate where no file states times: the cameras of KITTI were triggered at 10 Hz, and TartanAir is rendered at it.
_NOMINAL_RATE_HZ = 10.0

_FOURSEASONS_IMAGES = {"undistorted_images/cam0": "undistorted_calib_0.txt", "distorted_images/cam0": "calib_0.txt"}
_FOURSEASONS_MODELS = {"Pinhole": "pinhole", "Equidistant": "fisheye"}
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
    paths = images_of(images)
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
            for row in read_rows(path, root):
                values = numbers(row, fields_of(row), 12, "12 numbers of a 3x4 pose")
                poses.append(_matrix_pose(row[0], values) @ cam0_from_cam)
            check_count(path, poses, "poses", paths)
            break
    return image_sequence(
        "kitti",
        sequence,
        paths,
        name=f"{sequence.name}/{images.name}",
        stamps=stamps,
        rate_hz=_NOMINAL_RATE_HZ,
        camera=stored_camera(sequence, paths[0]) or camera,
        poses=poses,
    )


def _matrix_pose(place: str, values: list[float]) -> Pose:
    return pose_from_matrix(place, np.array(values).reshape(3, 4))


def _rectified(path: Path, root: Path, key: str, size: tuple[int, int]) -> tuple[Camera, Pose]:
    """The camera of a projection matrix ``K [I | t]``, and its pose cam0_from_cam."""
    for row in read_rows(path, root):
        name, _, rest = row[1].partition(":")
        if name.strip() == key:
            values = np.array(numbers(row, rest.split(), 12, f"{key}: and 12 numbers")).reshape(3, 4)
            if not (values[0, 0] > 0 and values[1, 1] > 0 and values[2, 2] > 0):
                raise SourceError(f"{row[0]}: {key} has no positive focal length")
            K = values[:, :3]
            if K[1, 0] != 0 or K[2, 0] != 0 or K[2, 1] != 0 or np.abs(values).max() > 1e100 * K[2, 2]:
                raise SourceError(f"{row[0]}: {key} is no projection matrix [fx 0 cx, 0 fy cy, 0 0 1 | K t]")
            values = values / values[2, 2]
            K = values[:, :3]
            camera = Camera("pinhole", *size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
            cam_from_cam0 = Pose(np.eye(3), np.asarray(np.linalg.solve(K, values[:, 3]), float))
            return camera, cam_from_cam0.inverse()
    raise SourceError(f"{path}: no line {key}:")


def find_kitti360(folder: Path) -> Path | None:
    """Find the image folder of a sequence, or of ``image_00`` or ``image_01`` in it."""
    if (folder / "data_rect").is_dir() and folder.resolve().name in ("image_00", "image_01"):
        return folder.resolve() / "data_rect"
    found = (folder / name / "data_rect" for name in ("image_00", "image_01"))
    return next((images for images in found if images.is_dir()), None)


def open_kitti360(_: Path, found: Path) -> ImageFileSource:
    """Open a KITTI-360 sequence, or one of its two perspective cameras."""
    images = found.resolve()
    sequence = images.parent.parent
    beside = sequence.parent.parent  # of data_2d_raw
    paths = list_images(images)
    if not paths or not all(path.stem.isascii() and path.stem.isdecimal() for path in paths):
        raise SourceError(f"{images}: holds no images, or some whose names are no frame numbers")
    frames = [int(path.stem) for path in paths]
    times = images.parent / "timestamps.txt"
    stamps = [(str(path), frame / _NOMINAL_RATE_HZ) for path, frame in zip(paths, frames, strict=True)]
    if times.exists():
        stamps = _dates(times, sequence, frames)
    camera, cam0_from_cam = None, Pose.identity()
    for home in (sequence, beside):
        path = home / "calibration" / "perspective.txt"
        if path.is_file():
            key = f"P_rect_{images.parent.name[-2:]}"
            camera, cam0_from_cam = _rectified(path, home, key, image_size(paths[0], sequence))
            break
    known: dict[int, Pose] = {}
    for home, part in ((sequence, ""), (beside, f"data_poses/{sequence.name}")):
        path = home / part / "cam0_to_world.txt"
        if path.is_file():
            for row in read_rows(path, home):
                frame, *values = numbers(row, fields_of(row), 13, "a frame number and a pose of 16 or 12 numbers")
                known.setdefault(round(frame), _matrix_pose(row[0], values) @ cam0_from_cam)
            break
    return image_sequence(
        "kitti360",
        sequence,
        paths,
        name=f"{sequence.name}/{images.parent.name}",
        stamps=stamps,
        camera=stored_camera(sequence, paths[0]) or camera,
        poses=[known.get(frame) for frame in frames] if known else (),
    )


def _dates(path: Path, root: Path, frames: list[int]) -> list[tuple[str, float]]:
    """The place and the seconds since the epoch of each frame."""
    rows = list(read_rows(path, root))
    if frames[-1] >= len(rows):
        raise SourceError(f"{path}: {len(rows)} times, but there is an image of frame {frames[-1]}")
    stamps = []
    for place, text in (rows[frame] for frame in frames):
        try:
            # The format has nine decimals, of which datetime keeps six.
            stamps.append((place, datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()))
        except ValueError:
            raise SourceError(f"{place}: expected a date and time, found {text[:40]!r}") from None
    return stamps


def find_fourseasons(folder: Path) -> Path | None:
    """Find the images of the left camera."""
    return next((folder / name for name in _FOURSEASONS_IMAGES if (folder / name).is_dir()), None)


def open_fourseasons(folder: Path, images: Path) -> ImageFileSource:
    """Open a 4Seasons recording."""
    paths = images_of(images)
    rows = [(str(path), path.stem) for path in paths]
    name = _FOURSEASONS_IMAGES[images.relative_to(folder).as_posix()]
    homes = (folder, folder.resolve().parent)
    found = ((home, home / part / name) for home in homes for part in ("calibration", "Calibration"))
    calibration = next(((path, home) for home, path in found if path.is_file()), None)
    gnss, odometry = folder / "GNSSPoses.txt", folder / "result.txt"
    path = next((path for path in (gnss, odometry) if path.is_file()), None)
    return image_sequence(
        "4seasons",
        folder,
        paths,
        stamps=[(row[0], stamp_of(row, [row[1]], "a name in nanoseconds")) for row in rows],
        unit=TimeUnit.NANOSECONDS,
        camera=stored_camera(folder, paths[0]) or (_fourseasons_camera(*calibration) if calibration else None),
        truth=None if path is None else read_trajectory(path, folder),
        truth_unit=TimeUnit.NANOSECONDS if path == gnss else TimeUnit.SECONDS,
    )


def _fourseasons_camera(path: Path, root: Path) -> Camera:
    rows = list(read_rows(path, root))
    if len(rows) < 2:
        raise CalibrationError(f"{path}: expected a line of the lens and one of the image size")
    fields = fields_of(rows[0])
    if fields[0] not in _FOURSEASONS_MODELS:
        known = " or ".join(_FOURSEASONS_MODELS)
        raise CalibrationError(f"{rows[0][0]}: the lens is {fields[0][:40]!r}: expected {known}")
    fx, fy, cx, cy, *distortion = numbers(rows[0], fields[1:], 8, "fx fy cx cy and four coefficients")
    width, height = numbers(rows[1], fields_of(rows[1]), 2, "width and height")
    model = _FOURSEASONS_MODELS[fields[0]]
    try:
        return Camera(model, int(width), int(height), fx, fy, cx, cy, tuple(distortion) if model == "fisheye" else ())
    except CalibrationError as error:
        raise CalibrationError(f"{rows[0][0]}: {error}") from None


def find_tartanair(folder: Path) -> tuple[Path, Path] | None:
    """Find the images and the poses of a sequence."""
    found = ((folder / images, folder / poses) for images, poses in _TARTANAIR)
    return next(((images, poses) for images, poses in found if images.is_dir() and poses.is_file()), None)


def open_tartanair(folder: Path, found: tuple[Path, Path]) -> ImageFileSource:
    """Open a TartanAir sequence."""
    paths = images_of(found[0])
    rows = read_poses(found[1], folder, "tx ty tz qx qy qz qw")
    poses = [with_axes(row.pose, "forward, right, down") for row in rows]
    check_count(found[1], poses, "poses", paths)
    width, height = size = image_size(paths[0], folder)
    camera = pinhole(str(folder), size, width / 2, width / 2, width / 2, height / 2)
    return image_sequence(
        "tartanair",
        folder,
        paths,
        rate_hz=_NOMINAL_RATE_HZ,
        camera=stored_camera(folder, paths[0]) or camera,
        poses=poses,
    )


LAYOUTS = (
    Layout("kitti360", "image_00/data_rect (KITTI-360)", find_kitti360, open_kitti360),
    Layout("kitti", "image_0 or image_2 (KITTI)", find_kitti, open_kitti),
    Layout("tartanair", "image_left with pose_left.txt (TartanAir)", find_tartanair, open_tartanair),
    Layout("4seasons", "undistorted_images/cam0 (4Seasons)", find_fourseasons, open_fourseasons),
)
