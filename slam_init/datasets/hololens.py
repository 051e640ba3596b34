"""Recordings of HoloLens 2 by the StreamRecorder of Microsoft's HoloLens2ForCV: the photo/video camera.

* ``PV/TICKS.png`` holds the images, as converted from ``.bytes`` by the scripts of the recorder. A tick is 100 ns.
* ``NAME_pv.txt`` holds ``cx,cy,width,height`` in its first line, then for each image ``ticks,fx,fy`` and the matrix
  world_from_cam of 4x4 numbers, of an OpenGL camera (x right, y up, z backward).

The focal length changes as the camera focuses.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, list_images
from slam_init.datasets.posed_images import common_camera, from_opengl
from slam_init.datasets.stamps import image_times, stamp_of
from slam_init.datasets.text import numbers, pose_from_matrix, read_rows, trajectory
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.camera import Camera

_TICK_S = 1e-7


def find_hololens_index(folder: str | os.PathLike[str]) -> Path | None:
    """Find the index of the photo/video camera."""
    folder = Path(folder)
    return next(iter(sorted(folder.glob("*_pv.txt"))), None) if (folder / "PV").is_dir() else None


def open_hololens(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a recording of HoloLens 2."""
    folder = Path(folder)
    index = find_hololens_index(folder)
    if index is None:
        raise SourceError(f"{folder}: holds no PV with NAME_pv.txt")
    rows = list(read_rows(index, folder))
    if len(rows) < 2:
        raise SourceError(f"{index}: lists no image")
    cx, cy, width, height = numbers(rows[0], rows[0][1].split(","), 4, "cx,cy,width,height")
    images = {path.stem: path for path in list_images(folder / "PV")}
    paths, stamps, places, cameras, poses = [], [], [], [], []
    for row in rows[1:]:
        fields = [field.strip() for field in row[1].split(",")]
        ticks = stamp_of(row, fields, "ticks,fx,fy and a matrix")
        fx, fy, *values = numbers(row, fields[1:], 18, "ticks,fx,fy and a matrix of 16 numbers")
        path = images.get(fields[0])
        if path is None:
            continue
        paths.append(path)
        stamps.append(ticks * _TICK_S)
        places.append(row[0])
        try:
            cameras.append(Camera("pinhole", int(width), int(height), fx, fy, cx, cy))
        except CalibrationError as error:
            raise CalibrationError(f"{row[0]}: {error}") from None
        # The recorder writes zeros for an image that it could not locate.
        matrix = np.array(values).reshape(4, 4)
        poses.append(from_opengl(pose_from_matrix(row[0], matrix)) if matrix[:3, :3].any() else None)
    if not paths:
        raise SourceError(f"{index}: none of its {len(rows) - 1} images is in PV: convert the .bytes to .png first")
    camera, kept, notes = common_camera(cameras, str(folder))
    if len(paths) < len(rows) - 1:
        notes = (f"{len(rows) - 1 - len(paths)} of {len(rows) - 1} listed images are not in the folder", *notes)
    chosen = [i for i, keep in enumerate(kept) if keep]
    timestamps_s, time_notes = image_times([stamps[i] for i in chosen], [places[i] for i in chosen])
    located = ((time_s, poses[i]) for time_s, i in zip(timestamps_s.tolist(), chosen, strict=True))
    truth = trajectory([(time_s, pose) for time_s, pose in located if pose is not None])
    name, kept_paths = folder.resolve().name, tuple(paths[i] for i in chosen)
    return ImageFileSource(name, "hololens", kept_paths, timestamps_s, camera, truth, (*time_notes, *notes), folder)
