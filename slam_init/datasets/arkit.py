"""Recordings of Apple's ARKit: ARKitScenes, Record3D, Stray Scanner.

* **ARKitScenes**: ``lowres_wide/NAME_SECONDS.png``, ``lowres_wide_intrinsics/NAME_SECONDS.pincam``
  (``width height fx fy cx cy``) and ``lowres_wide.traj`` (``seconds``, a rotation vector in radians, a translation), in
  the folder or in ``NAME_frames``. The poses are cam_from_world with the axes of this project.
* **Record3D**: ``metadata.json`` with ``w``, ``h``, ``K`` (column after column), ``fps`` and ``poses``
  (``qx qy qz qw tx ty tz``, world_from_cam of an OpenGL camera), and ``rgb/NUMBER.jpg`` or ``rgbd/NUMBER.jpg``.
* **Stray Scanner**: ``camera_matrix.csv`` (3x3), ``odometry.csv`` (``timestamp, frame, x, y, z, qx, qy, qz, qw``,
  world_from_cam with the axes of this project), and ``rgb.mp4`` or images in ``rgb``.

The poses are estimates of ARKit, which drift, and no measurement.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets.bounded import json_array, json_number, read_json
from slam_init.datasets.image_files import ImageFileSource, check_size, frame_range, list_images, read_image
from slam_init.datasets.posed_images import common_camera, from_opengl
from slam_init.datasets.stamps import image_times, stamp_of
from slam_init.datasets.text import numbers, pose_from_quaternion, read_rows, trajectory
from slam_init.datasets.timed import TimedSource
from slam_init.datasets.video import VideoSource, open_video
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Pose, Trajectory

# A calibration belongs to an image if their stamps differ by no more than this: they are rounded to milliseconds.
_SAME_STAMP_S = 0.0015


def find_arkitscenes(folder: str | os.PathLike[str]) -> Path | None:
    """Find the folder that holds the frames."""
    folder = Path(folder)
    candidates = (folder, folder / f"{folder.resolve().name}_frames")
    return next((p for p in candidates if (p / "lowres_wide.traj").is_file() and (p / "lowres_wide").is_dir()), None)


def open_arkitscenes(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a video of ARKitScenes."""
    folder = Path(folder)
    frames = find_arkitscenes(folder)
    if frames is None:
        raise SourceError(f"{folder}: holds no lowres_wide with lowres_wide.traj")
    paths = list_images(frames / "lowres_wide")
    if not paths:
        raise SourceError(f"{frames / 'lowres_wide'}: holds no image")
    rows = [(str(path), path.stem.rpartition("_")[2]) for path in paths]
    stamps = [stamp_of(row, [row[1]], "a name with seconds at its end") for row in rows]
    timestamps_s, notes = image_times(stamps, [place for place, _ in rows])
    pincams = frames / "lowres_wide_intrinsics"
    cameras = _pincams(pincams, folder, timestamps_s) if pincams.is_dir() else [None] * len(paths)
    camera, kept, camera_notes = common_camera(cameras, str(folder))
    stamped = []
    for row in read_rows(frames / "lowres_wide.traj", folder):
        fields = row[1].split()
        time_s, rx, ry, rz, tx, ty, tz = numbers(row, fields, 7, "seconds, a rotation vector and a translation")
        cam_from_world = Pose(rotation_from_vector(np.array([rx, ry, rz])), np.array([tx, ty, tz]))
        stamped.append((time_s, cam_from_world.inverse()))
    chosen = tuple(path for path, keep in zip(paths, kept, strict=True) if keep)
    times_s = timestamps_s[np.array(kept)]
    name = folder.resolve().name
    return ImageFileSource(
        name, "arkitscenes", chosen, times_s, camera, trajectory(stamped), (*notes, *camera_notes), folder
    )


def _pincams(folder: Path, root: Path, timestamps_s: Floats) -> list[Camera | None]:
    """The calibration of each image, by the seconds in the names."""
    files = {}
    for path in folder.glob("*.pincam"):
        if re.fullmatch(r"\d+\.\d+", stamp := path.stem.rpartition("_")[2], re.ASCII):
            files[float(stamp)] = path
    if not files:
        raise SourceError(f"{folder}: holds no .pincam of an image")
    known_s = np.array(sorted(files))
    cameras: list[Camera | None] = []
    for time_s in timestamps_s.tolist():
        nearest = float(known_s[np.argmin(np.abs(known_s - time_s))])
        path = files[nearest]
        if abs(nearest - time_s) > _SAME_STAMP_S:
            raise SourceError(f"{folder}: no calibration for the image of {time_s:.3f} s")
        row = next(read_rows(path, root), (str(path), ""))
        width, height, fx, fy, cx, cy = numbers(row, row[1].split(), 6, "width height fx fy cx cy")
        cameras.append(_camera(row[0], (int(width), int(height)), fx, fy, cx, cy))
    return cameras


def _camera(place: str, size: tuple[int, int], fx: float, fy: float, cx: float, cy: float) -> Camera:
    try:
        return Camera("pinhole", *size, fx, fy, cx, cy)
    except CalibrationError as error:
        raise CalibrationError(f"{place}: {error}") from None


def find_record3d(folder: str | os.PathLike[str]) -> tuple[Path, Path] | None:
    """Find the index and the images of a recording of Record3D.

    Shapes: returns (Path, Path).

    * Returns: ``metadata.json`` (``metadata`` in an unpacked ``.r3d``) and the image folder; None if this is no such
      folder.
    """
    folder = Path(folder)
    index = next((folder / name for name in ("metadata.json", "metadata") if (folder / name).is_file()), None)
    images = next((folder / name for name in ("rgb", "rgbd") if (folder / name).is_dir()), None)
    return None if index is None or images is None else (index, images)


def open_record3d(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a recording of Record3D."""
    folder = Path(folder)
    found = find_record3d(folder)
    if found is None:
        raise SourceError(f"{folder}: holds no metadata.json with rgb")
    index, images = found
    content = read_json(index, folder, "the index of Record3D")
    place = str(index)
    rows = json_array(place, content.get("poses"), (-1, 7), "poses")
    paths = list_images(images)
    if len(rows) != len(paths) or not paths:
        raise SourceError(f"{index}: {len(rows)} poses for {len(paths)} images in {images.name}")
    K = json_array(place, content.get("K"), (9,), "K").reshape(3, 3).T
    size = round(json_number(place, content, "w")), round(json_number(place, content, "h"))
    rate_hz = json_number(place, content, "fps", 60.0)
    if not 0 < rate_hz <= 1000:
        raise SourceError(f"{index}: fps is {rate_hz:g}: expected frames a second")
    camera = _camera(f"{index}: K", size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    timestamps_s = np.arange(len(paths)) / rate_hz
    stamped = []
    for number, (time_s, values) in enumerate(zip(timestamps_s.tolist(), rows.tolist(), strict=True)):
        qx, qy, qz, qw, *t = values
        pose = pose_from_quaternion((f"{index}: pose {number}", ""), t, [qw, qx, qy, qz])
        stamped.append((time_s, from_opengl(pose)))
    return ImageFileSource(
        folder.resolve().name, "record3d", tuple(paths), timestamps_s, camera, trajectory(stamped), root=folder
    )


def is_stray_scanner(folder: str | os.PathLike[str]) -> bool:
    """Tell whether a folder is a recording of Stray Scanner."""
    folder = Path(folder)
    tables = (folder / "odometry.csv", folder / "camera_matrix.csv")
    return all(path.is_file() for path in tables) and ((folder / "rgb.mp4").is_file() or (folder / "rgb").is_dir())


def open_stray_scanner(folder: str | os.PathLike[str]) -> TimedSource:
    """Open a recording of Stray Scanner."""
    folder = Path(folder)
    rows = [row for row in read_rows(folder / "odometry.csv", folder) if not row[1].startswith("timestamp")]
    if not rows:
        raise SourceError(f"{folder / 'odometry.csv'}: holds no pose")
    stamps, poses = [], []
    for row in rows:
        fields = [field.strip() for field in row[1].split(",")]
        what = "timestamp, frame, x, y, z, qx, qy, qz, qw"
        stamps.append(stamp_of(row, fields, what))
        tx, ty, tz, qx, qy, qz, qw = numbers(row, fields[2:], 7, what)
        poses.append(pose_from_quaternion(row, [tx, ty, tz], [qw, qx, qy, qz]))
    timestamps_s, notes = image_times(stamps, [place for place, _ in rows])
    truth = trajectory(list(zip(timestamps_s.tolist(), poses, strict=True)))
    video_file = folder / "rgb.mp4"
    if not video_file.is_file():
        paths = list_images(folder / "rgb")
        if len(paths) != len(rows):
            raise SourceError(f"{folder / 'odometry.csv'}: {len(rows)} poses for {len(paths)} images in rgb")
        height, width = read_image(paths[0], folder).shape[:2]
        camera = _stray_camera(folder, (width, height))
        name = folder.resolve().name
        return ImageFileSource(name, "stray-scanner", tuple(paths), timestamps_s, camera, truth, notes, folder)
    check_inside(video_file, folder)
    video = open_video(video_file)
    length = min(len(video), len(rows))
    if len(video) != len(rows):
        notes = (*notes, f"{len(rows)} poses for {len(video)} frames of rgb.mp4: the first {length} are used")
    return PosedVideo(
        folder.resolve().name, video, _stray_camera(folder, video.size), timestamps_s[:length], truth, notes
    )


def _stray_camera(folder: Path, size: tuple[int, int]) -> Camera:
    path = folder / "camera_matrix.csv"
    rows = list(read_rows(path, folder))
    if len(rows) != 3:
        raise CalibrationError(f"{path}: {len(rows)} lines: expected a matrix of 3x3 numbers")
    K = [numbers(row, row[1].split(","), 3, "three numbers") for row in rows]
    return _camera(str(path), size, K[0][0], K[1][1], K[0][2], K[1][2])


@dataclass(frozen=True, eq=False)
class PosedVideo:
    """A :class:`slam_init.types.frame.Source` over a video whose times, poses and calibration are stated beside it."""

    name: str
    video: VideoSource
    camera: Camera
    #: (N,) Strictly increasing; the frames after the last stamp are left out.
    timestamps_s: Floats
    groundtruth: Trajectory | None
    notes: tuple[str, ...] = ()
    kind: str = "stray-scanner"

    def __len__(self) -> int:
        return len(self.timestamps_s)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Decode frames in order."""
        wanted = frame_range(len(self), start, max_frames, self.name)
        expected = (self.camera.width, self.camera.height)
        for frame in self.video.frames(start, len(wanted)):
            size = (frame.image.shape[1], frame.image.shape[0])
            check_size(f"{self.name}, frame {frame.index}", size, expected, "the camera")
            yield replace(frame, timestamp_s=float(self.timestamps_s[frame.index]))
