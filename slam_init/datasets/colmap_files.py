"""Readers of COLMAP models: ``cameras`` and ``images`` as text or binary files.

A pose of COLMAP is ``cam_from_world``, with the axes of this project. Its pixel centres lie at .5; half a pixel is
subtracted from the principal point, as in :func:`slam_init.calibration.formats.parse_colmap`.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slam_init.calibration.colmap_models import COLMAP_PARAMETERS, NUMBERED
from slam_init.calibration.formats import parse_colmap
from slam_init.datasets.text import Row, numbers, pose_from_quaternion, read_lines, read_rows
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

# A thousand images with ten thousand points each have 240 MB.
_MAX_BYTES = 2_000_000_000
_MAX_CAMERAS_BYTES = 100_000_000


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """An image of a model."""

    #: Relative to the image folder.
    name: str
    camera_id: int
    cam_from_world: Pose


def model_files(folder: str | os.PathLike[str]) -> tuple[Path, Path] | None:
    """Find the files of a model in a folder. Binary files are preferred, as COLMAP does."""
    folder = Path(folder)
    for suffix in (".bin", ".txt"):
        files = folder / f"cameras{suffix}", folder / f"images{suffix}"
        if all(file.is_file() for file in files):
            return files
    return None


def read_cameras(path: Path, root: Path) -> dict[int, Camera]:
    """Read ``cameras.txt`` or ``cameras.bin``.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    if path.suffix == ".bin":
        return _read_cameras_bin(path, root)
    cameras = {}
    for place, text in read_rows(path, root):
        fields = text.split()
        try:
            cameras[_index((place, text), fields[0])] = parse_colmap(text)
        except CalibrationError as error:
            raise CalibrationError(f"{place}: {error}") from None
    return cameras


def colmap_camera(place: str, model: int, width: int, height: int, parameters: Sequence[float]) -> Camera:
    """Make a camera of the number of its model and its parameters, as in binary files and databases."""
    name = NUMBERED[model] if 0 <= model < len(NUMBERED) else f"number {model}"
    values = " ".join(repr(float(value)) for value in parameters)
    try:
        return parse_colmap(f"1 {name} {width} {height} {values}")
    except CalibrationError as error:
        raise CalibrationError(f"{place}: {error}") from None


def read_images(path: Path, root: Path) -> list[ColmapImage]:
    """Read ``images.txt`` or ``images.bin``; the observations are skipped."""
    if path.suffix == ".bin":
        return _read_images_bin(path, root)
    images = []
    lines = ((place, line) for place, line in read_lines(path, root) if not line.startswith("#"))
    for row in lines:
        if not row[1]:
            continue
        fields = row[1].split(maxsplit=9)  # a name may hold spaces
        if len(fields) < 10:
            raise SourceError(f"{row[0]}: expected id, quaternion, translation, camera and name, found {row[1][:60]!r}")
        qw, qx, qy, qz, *t = numbers(row, fields[1:8], 7, "a quaternion and a translation")
        pose = pose_from_quaternion(row, t, [qw, qx, qy, qz])
        images.append(ColmapImage(fields[9], _index(row, fields[8]), pose))
        next(lines, None)  # its points, perhaps none
    return images


def _index(row: Row, field: str) -> int:
    try:
        return int(field)
    except ValueError:
        raise SourceError(f"{row[0]}: expected a whole number, found {field[:40]!r}") from None


class _Bytes:
    """Reads values one after the other; a file that ends too early is an error."""

    def __init__(self, path: Path, root: Path, limit_bytes: int) -> None:
        check_inside(path, root)
        self._path = path
        self._data = memoryview(read_regular(path, limit_bytes, "a COLMAP model", SourceError))
        self._at = 0

    def unpack(self, layout: str) -> tuple[float, ...]:
        try:
            values = struct.unpack_from(layout, self._data, self._at)
        except struct.error:
            raise self._cut_off() from None
        self._at += struct.calcsize(layout)
        return values

    def index(self, layout: str) -> int:
        return int(self.unpack(layout)[0])

    def skip(self, count: int) -> None:
        self._at += count
        if self._at > len(self._data):
            raise self._cut_off()

    def name(self, limit: int = 4096) -> str:
        window = bytes(self._data[self._at : self._at + limit])
        end = window.find(b"\0")
        if end < 0:
            raise SourceError(f"{self._path}: holds a file name without an end, or is cut off")
        self._at += end + 1
        return window[:end].decode("utf-8", "surrogateescape")

    def _cut_off(self) -> SourceError:
        return SourceError(f"{self._path}: the file is cut off, or is no COLMAP model")


def _read_cameras_bin(path: Path, root: Path) -> dict[int, Camera]:
    data = _Bytes(path, root, _MAX_CAMERAS_BYTES)
    cameras = {}
    for _ in range(data.index("<Q")):  # ends with the data, however many are stated
        camera_id, model, width, height = (int(value) for value in data.unpack("<iiQQ"))
        place = f"{path}: camera {camera_id}"
        if not 0 <= model < len(NUMBERED):
            raise CalibrationError(f"{place}: unknown camera model number {model}")
        count = len(COLMAP_PARAMETERS[NUMBERED[model]].split())
        cameras[camera_id] = colmap_camera(place, model, width, height, data.unpack(f"<{count}d"))
    return cameras


def _read_images_bin(path: Path, root: Path) -> list[ColmapImage]:
    data = _Bytes(path, root, _MAX_BYTES)
    images = []
    for number in range(data.index("<Q")):
        data.skip(4)  # the id of the image
        row = (f"{path}: image {number + 1}", "")
        values = [repr(value) for value in data.unpack("<7d")]
        qw, qx, qy, qz, *t = numbers(row, values, 7, "a finite pose")
        camera_id = data.index("<i")
        name = data.name()
        data.skip(24 * data.index("<Q"))
        images.append(ColmapImage(name, camera_id, pose_from_quaternion(row, t, [qw, qx, qy, qz])))
    return images
