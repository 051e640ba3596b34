"""Recordings of phones and headsets: ARKitScenes, Record3D, Stray Scanner, HoloLens 2.

**ARKitScenes**: ``lowres_wide/NAME_SECONDS.png``, ``lowres_wide_intrinsics/NAME_SECONDS.pincam``
(``width height fx fy cx cy``) and ``lowres_wide.traj`` (``seconds``, a rotation vector in radians, a translation), in
the folder or in ``NAME_frames``. The poses are cam_from_world with the axes of this project.

**Record3D**: ``metadata.json`` (``metadata`` in an unpacked ``.r3d``) with ``w``, ``h``, ``K`` (column after column),
``fps`` and ``poses`` (``qx qy qz qw tx ty tz``, world_from_cam of an OpenGL camera), and ``rgb/NUMBER.jpg`` or
``rgbd/NUMBER.jpg``.

**Stray Scanner**: ``camera_matrix.csv`` (3x3), ``odometry.csv`` (``timestamp, frame, x, y, z, qx, qy, qz, qw``,
world_from_cam with the axes of this project), and ``rgb.mp4`` or images in ``rgb``.

The poses of these three are estimates of Apple's ARKit, which drift, and no measurement.

**HoloLens 2**, the photo/video camera as written by the StreamRecorder of Microsoft's HoloLens2ForCV:

* ``PV/TICKS.png`` holds the images, as converted from ``.bytes`` by the scripts of the recorder. A tick is 100 ns.
* ``NAME_pv.txt`` holds ``cx,cy,width,height`` in its first line, then for each image ``ticks,fx,fy`` and the matrix
  world_from_cam of 4x4 numbers, of an OpenGL camera (x right, y up, z backward). The focal length changes as the camera
  focuses. Zeros stand for the pose of an image that the recorder could not locate.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets.bounded import json_array, json_number, read_json
from slam_init.datasets.image_files import ImageFileSource, image_size, images_of, list_images
from slam_init.datasets.posed_images import Layout, image_sequence, with_axes
from slam_init.datasets.stamps import image_times, stamp_of
from slam_init.datasets.text import (
    check_count,
    fields_of,
    numbers,
    pinhole,
    pose_from_matrix,
    pose_from_quaternion,
    read_poses,
    read_rows,
    stamps_of,
    trajectory,
)
from slam_init.datasets.video import open_video
from slam_init.datasets.views import RestatedSource
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.camera import Camera
from slam_init.types.frame import TimedSource
from slam_init.types.pose import Pose

# A calibration of ARKitScenes belongs to an image if their stamps differ by no more than this: they are rounded to
# milliseconds.
_SAME_STAMP_S = 0.0015
_TICK_S = 1e-7


def find_arkitscenes(folder: Path) -> Path | None:
    """Find the folder that holds the frames."""
    candidates = (folder, folder / f"{folder.resolve().name}_frames")
    return next((p for p in candidates if (p / "lowres_wide.traj").is_file() and (p / "lowres_wide").is_dir()), None)


def open_arkitscenes(folder: Path, frames: Path) -> ImageFileSource:
    """Open a video of ARKitScenes."""
    paths = images_of(frames / "lowres_wide")
    rows = [(str(path), path.stem.rpartition("_")[2]) for path in paths]
    stamps = [(row[0], stamp_of(row, [row[1]], "a name with seconds at its end")) for row in rows]
    pincams = frames / "lowres_wide_intrinsics"
    stamped = []
    for row in read_rows(frames / "lowres_wide.traj", folder):
        what = "seconds, a rotation vector and a translation"
        time_s, rx, ry, rz, tx, ty, tz = numbers(row, fields_of(row), 7, what)
        cam_from_world = Pose(rotation_from_vector(np.array([rx, ry, rz])), np.array([tx, ty, tz]))
        stamped.append((time_s, cam_from_world.inverse()))
    return image_sequence(
        "arkitscenes",
        folder,
        paths,
        stamps=stamps,
        cameras=_pincams(pincams, folder, stamps) if pincams.is_dir() else (),
        truth=trajectory(stamped),
    )


def _pincams(folder: Path, root: Path, stamps: list[tuple[str, float]]) -> list[Camera]:
    """The calibration of each image, by the seconds in the names."""
    files = {}
    for path in folder.glob("*.pincam"):
        if re.fullmatch(r"\d+\.\d+", stamp := path.stem.rpartition("_")[2], re.ASCII):
            files[float(stamp)] = path
    if not files:
        raise SourceError(f"{folder}: holds no .pincam of an image")
    known_s = np.array(sorted(files))
    times_s, _ = image_times([stamp for _, stamp in stamps], [place for place, _ in stamps])
    cameras = []
    for time_s in times_s.tolist():
        nearest = float(known_s[np.argmin(np.abs(known_s - time_s))])
        if abs(nearest - time_s) > _SAME_STAMP_S:
            raise SourceError(f"{folder}: no calibration for the image of {time_s:.3f} s")
        row = next(read_rows(files[nearest], root), (str(files[nearest]), ""))
        width, height, *focal = numbers(row, fields_of(row), 6, "width height fx fy cx cy")
        cameras.append(pinhole(row[0], (int(width), int(height)), *focal))
    return cameras


def find_record3d(folder: Path) -> tuple[Path, Path] | None:
    """Find the index and the images of a recording of Record3D."""
    index = next((folder / name for name in ("metadata.json", "metadata") if (folder / name).is_file()), None)
    images = next((folder / name for name in ("rgb", "rgbd") if (folder / name).is_dir()), None)
    return None if index is None or images is None else (index, images)


def open_record3d(folder: Path, found: tuple[Path, Path]) -> ImageFileSource:
    """Open a recording of Record3D."""
    index, images = found
    place, content = str(index), read_json(index, folder, "the index of Record3D")
    rows, paths = json_array(place, content.get("poses"), (-1, 7), "poses"), images_of(images)
    check_count(index, rows.tolist(), "poses", paths)
    K = json_array(place, content.get("K"), (9,), "K").reshape(3, 3).T
    size = round(json_number(place, content, "w")), round(json_number(place, content, "h"))
    rate_hz = json_number(place, content, "fps", 60.0)
    if not 0 < rate_hz <= 1000:
        raise SourceError(f"{index}: fps is {rate_hz:g}: expected frames a second")
    poses = []
    for number, (qx, qy, qz, qw, *t) in enumerate(rows.tolist()):
        pose = pose_from_quaternion((f"{index}: pose {number}", ""), t, [qw, qx, qy, qz])
        poses.append(with_axes(pose, "right, up, backward"))
    camera = pinhole(f"{index}: K", size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return image_sequence("record3d", folder, paths, rate_hz=rate_hz, camera=camera, poses=poses)


def is_stray_scanner(folder: Path) -> bool:
    """Tell whether a folder is a recording of Stray Scanner."""
    tables = (folder / "odometry.csv", folder / "camera_matrix.csv")
    return all(path.is_file() for path in tables) and ((folder / "rgb.mp4").is_file() or (folder / "rgb").is_dir())


def open_stray_scanner(folder: Path, _: bool) -> TimedSource:
    """Open a recording of Stray Scanner."""
    table = folder / "odometry.csv"
    rows = list(read_poses(table, folder, "timestamp frame tx ty tz qx qy qz qw"))
    times = stamps_of(rows)
    if not rows or times is None:
        raise SourceError(f"{table}: holds no poses with a time stamp each")
    stamps, poses = [(one.row[0], time) for one, time in zip(rows, times, strict=True)], [one.pose for one in rows]
    if not (folder / "rgb.mp4").is_file():
        paths = images_of(folder / "rgb")
        check_count(table, rows, "poses", paths)
        camera = _stray_camera(folder, image_size(paths[0], folder))
        return image_sequence("stray-scanner", folder, paths, stamps=stamps, camera=camera, poses=poses)
    check_inside(folder / "rgb.mp4", folder)
    video = open_video(folder / "rgb.mp4")
    times_s, notes = image_times([stamp for _, stamp in stamps], [place for place, _ in stamps])
    length = min(len(video), len(rows))
    if len(video) != len(rows):
        notes = (*notes, f"{len(rows)} poses for {len(video)} frames of rgb.mp4: the first {length} are used")
    return RestatedSource(
        video,
        folder.resolve().name,
        "stray-scanner",
        _stray_camera(folder, video.size),
        times_s[:length],
        trajectory(list(zip(times_s.tolist(), poses, strict=True))),
        notes,
    )


def _stray_camera(folder: Path, size: tuple[int, int]) -> Camera:
    path = folder / "camera_matrix.csv"
    rows = list(read_rows(path, folder))
    if len(rows) != 3:
        raise CalibrationError(f"{path}: {len(rows)} lines: expected a matrix of 3x3 numbers")
    K = [numbers(row, fields_of(row), 3, "three numbers") for row in rows]
    return pinhole(str(path), size, K[0][0], K[1][1], K[0][2], K[1][2])


def find_hololens(folder: Path) -> Path | None:
    """Find the index of the photo/video camera."""
    return next(iter(sorted(folder.glob("*_pv.txt"))), None) if (folder / "PV").is_dir() else None


def open_hololens(folder: Path, index: Path) -> ImageFileSource:
    """Open a recording of HoloLens 2."""
    first, *rows = list(read_rows(index, folder)) or [(str(index), "")]
    cx, cy, width, height = numbers(first, fields_of(first), 4, "cx,cy,width,height")
    images = {path.stem: path for path in list_images(folder / "PV")}
    paths, stamps, cameras, poses = [], [], [], list[Pose | None]()
    for row in rows:
        what = "ticks,fx,fy and a matrix of 16 numbers"
        ticks, values = fields_of(row)[0], numbers(row, fields_of(row), 19, what)
        if ticks not in images:
            continue
        paths.append(images[ticks])
        stamps.append((row[0], stamp_of(row, [ticks], what) * _TICK_S))
        cameras.append(pinhole(row[0], (int(width), int(height)), values[1], values[2], cx, cy))
        matrix = np.array(values[3:]).reshape(4, 4)
        located = matrix[:3, :3].any()
        poses.append(with_axes(pose_from_matrix(row[0], matrix), "right, up, backward") if located else None)
    if not paths:
        raise SourceError(f"{index}: none of its {len(rows)} images is in PV: convert the .bytes to .png first")
    missing = len(rows) - len(paths)
    notes = (f"{missing} of {len(rows)} listed images are not in the folder",) if missing else ()
    return image_sequence("hololens", folder, paths, stamps=stamps, cameras=cameras, poses=poses, notes=notes)


LAYOUTS = (
    Layout("hololens", "PV with NAME_pv.txt (HoloLens 2)", find_hololens, open_hololens),
    Layout("arkitscenes", "lowres_wide.traj (ARKitScenes)", find_arkitscenes, open_arkitscenes),
    Layout("record3d", "metadata.json with rgb (Record3D)", find_record3d, open_record3d),
    Layout("stray-scanner", "odometry.csv, camera_matrix.csv (Stray Scanner)", is_stray_scanner, open_stray_scanner),
)
