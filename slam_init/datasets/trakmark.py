"""Sequences in the manner of TrakMark, the benchmark of which [F17] uses the NAIST sequences.

TrakMark provides images with intrinsic parameters and, for each image, extrinsic parameters. The names and headers of
its files differ between the packages, and could not be checked with a file of the data set. This reader takes the
general form:

* images in the folder or in ``images``;
* one text file with ``intrinsic`` in its name: ``fx fy cx cy``, or a matrix of 3x3 numbers;
* one text file with ``extrinsic`` in its name: for each image in the order of the names a line of 12 or 16 numbers, the
  matrix cam_from_world, perhaps with a frame number before it.

Numbers are separated by spaces, tabs or commas; lines that start with ``#`` are comments.

References
----------
.. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", arXiv:1704.02672.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from slam_init.datasets.folder import NOMINAL_RATE_HZ, find_images
from slam_init.datasets.image_files import ImageFileSource, read_image, stored_camera
from slam_init.datasets.text import Row, numbers, pose_from_matrix, read_rows, trajectory
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.camera import Camera

_SUFFIXES = (".txt", ".csv", ".dat")


def find_trakmark_extrinsics(folder: str | os.PathLike[str]) -> Path | None:
    """Find the extrinsic parameters of a sequence."""
    return _named(Path(folder), "extrinsic")


def _named(folder: Path, word: str) -> Path | None:
    found = (path for path in sorted(folder.glob("*")) if word in path.name.lower() and path.suffix in _SUFFIXES)
    return next((path for path in found if path.is_file()), None)


def open_trakmark(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a sequence in the manner of TrakMark."""
    folder = Path(folder)
    extrinsics = find_trakmark_extrinsics(folder)
    if extrinsics is None:
        raise SourceError(f"{folder}: holds no table of extrinsic parameters")
    paths = find_images(folder)
    if not paths:
        raise SourceError(f"{folder}: holds no image")
    rows = [(place, _fields(text)) for place, text in read_rows(extrinsics, folder)]
    if len(rows) != len(paths):
        raise SourceError(f"{extrinsics}: {len(rows)} poses for {len(paths)} images")
    timestamps_s = np.arange(len(paths)) / NOMINAL_RATE_HZ
    stamped = []
    for time_s, (place, fields) in zip(timestamps_s.tolist(), rows, strict=True):
        row = (place, " ".join(fields))
        matrix = fields[len(fields) % 4 :]  # 13 and 17 fields start with the number of the frame
        if len(fields) not in (12, 13, 16, 17):
            raise SourceError(f"{place}: expected 12 or 16 numbers of a pose, found {row[1][:60]!r}")
        values = numbers(row, matrix, 12, "12 or 16 numbers of a pose")
        stamped.append((time_s, pose_from_matrix(place, np.array(values).reshape(3, 4)).inverse()))
    camera = stored_camera(folder, paths[0])
    intrinsics = _named(folder, "intrinsic")
    if camera is None and intrinsics is not None:
        height, width = read_image(paths[0], folder).shape[:2]
        camera = _read_camera(intrinsics, folder, (width, height))
    name = folder.resolve().name
    return ImageFileSource(name, "trakmark", tuple(paths), timestamps_s, camera, trajectory(stamped), root=folder)


def _fields(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _read_camera(path: Path, root: Path, size: tuple[int, int]) -> Camera:
    rows: list[Row] = list(read_rows(path, root))
    fields = [field for _, text in rows for field in _fields(text)]
    row = (str(path), " ".join(fields))
    if len(fields) == 9:
        K = numbers(row, fields, 9, "a matrix of 3x3 numbers")
        focal = (K[0], K[4], K[2], K[5])
    elif len(fields) == 4:
        fx, fy, cx, cy = numbers(row, fields, 4, "fx fy cx cy")
        focal = (fx, fy, cx, cy)
    else:
        raise CalibrationError(f"{path}: {len(fields)} numbers: expected fx fy cx cy, or a matrix of 3x3 numbers")
    try:
        return Camera("pinhole", *size, *focal)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None
