"""COLMAP's models (``cameras`` and ``images``, text or binary), and its ``database.db`` as a source of tracks.

A pose of COLMAP is ``cam_from_world``, with the axes of this project. Its pixel centres lie at .5; half a pixel is
subtracted from principal points, as in :func:`slam_init.calibration.formats.parse_colmap`, and from keypoints.

COLMAP, hloc (SuperPoint, LightGlue, LoFTR) and RoMa write databases. The verified matches of ``two_view_geometries``
are taken; where there are none, ``matches``. The camera is that of the table ``cameras`` where its focal length is
marked as known (``prior_focal_length``). A database is read and never written: no journal and no shared memory is made
beside it.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from slam_init.calibration.formats import parse_colmap
from slam_init.calibration.models import COLMAP_PARAMETERS, NUMBERED
from slam_init.calibration.values import at_place
from slam_init.datasets.posed_images import common_camera
from slam_init.datasets.text import Row, numbers, pose_from_quaternion, read_lines, read_rows
from slam_init.datasets.track_source import PairMatches, TrackSource, by_name, chain_matches, track_source
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

# -- models ----------------------------------------------------------------------------------------


# A thousand images with ten thousand points each have 240 MB.
_MAX_MODEL_BYTES = 2_000_000_000


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """An image of a model."""

    #: Relative to the image folder.
    name: str
    camera_id: int
    cam_from_world: Pose
    #: Reads the keypoints (N, 2), with pixel centres at integer coordinates, and their points (N,); -1 for none.
    keypoints: Callable[[], tuple[Floats, Ints]]


def model_files(folder: Path) -> tuple[Path, Path] | None:
    """Find the files of a model in a folder. Binary files are preferred, as COLMAP does."""
    for suffix in (".bin", ".txt"):
        files = folder / f"cameras{suffix}", folder / f"images{suffix}"
        if all(file.is_file() for file in files):
            return files
    return None


def read_model(model: Path, root: Path) -> tuple[list[ColmapImage], dict[int, Camera]]:
    """Read the images and cameras of a model, whose folder :func:`model_files` has found.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    cameras_file, images_file = model_files(model) or (model / "cameras.txt", model / "images.txt")
    if cameras_file.suffix == ".bin":
        cameras, images = _cameras_of_bytes(_Bytes(cameras_file, root)), _images_of_bytes(_Bytes(images_file, root))
    else:
        cameras, images = _cameras_of_text(cameras_file, root), _images_of_text(images_file, root)
    known, found = dict(cameras), list(images)
    if not found:
        raise SourceError(f"{images_file}: holds no image: give the folder of a model with images")
    for image in found:
        if image.camera_id not in known:
            raise SourceError(f"{images_file}: {image.name[:100]} has camera {image.camera_id}, which is not stated")
    return found, known


def _cameras_of_text(path: Path, root: Path) -> Iterator[tuple[int, Camera]]:
    for place, text in read_rows(path, root):
        yield _index((place, text), text.split()), _parsed_camera(place, text)


def _images_of_text(path: Path, root: Path) -> Iterator[ColmapImage]:
    lines = ((place, line) for place, line in read_lines(path, root) if not line.startswith("#"))
    for row in lines:
        if not row[1]:
            continue
        fields = row[1].split(maxsplit=9)  # a name may hold spaces
        if len(fields) < 10:
            raise SourceError(f"{row[0]}: expected id, quaternion, translation, camera and name, found {row[1][:60]!r}")
        keypoints = partial(_keypoints_of_line, next(lines, ("", "")))
        yield ColmapImage(fields[9], _index(row, fields[8:]), _pose(row, fields[1:8]), keypoints)


def _parsed_camera(place: str, line: str) -> Camera:
    with at_place(place):
        return parse_colmap(line)


def _numbered_camera(place: str, name: str, width: int, height: int, parameters: Sequence[float]) -> Camera:
    return _parsed_camera(place, f"1 {name} {width} {height} {' '.join(repr(float(value)) for value in parameters)}")


def _model_name(place: str, number: int) -> str:
    """The model of a number, as in binary files and databases."""
    if not 0 <= number < len(NUMBERED):
        raise CalibrationError(f"{place}: unknown camera model number {number}")
    return NUMBERED[number]


def _pose(row: Row, fields: list[str]) -> Pose:
    qw, qx, qy, qz, *t = numbers(row, fields, 7, "a quaternion and a translation")
    return pose_from_quaternion(row, t, [qw, qx, qy, qz])


def _index(row: Row, fields: list[str]) -> int:
    return int(numbers(row, fields, 1, "the number of a camera")[0])


def _keypoints_of_line(row: Row) -> tuple[Floats, Ints]:
    """The keypoints of an image, and their points: X, Y and POINT3D_ID for each."""
    fields = row[1].split()
    values = np.array(numbers(row, fields, len(fields), "X, Y and POINT3D_ID for each point"))
    if len(values) % 3:
        raise SourceError(f"{row[0]}: expected X, Y and POINT3D_ID for each point, found {len(values)} numbers")
    table = values.reshape(-1, 3)
    return table[:, :2] - 0.5, table[:, 2].astype(np.int64)


def _keypoints_of_bytes(data: memoryview) -> tuple[Floats, Ints]:
    rows = np.frombuffer(data, [("xy", "<f8", 2), ("point", "<i8")])
    return rows["xy"] - 0.5, rows["point"].astype(np.int64)


class _Bytes:
    """Reads values one after the other; a file that ends too early is an error."""

    def __init__(self, path: Path, root: Path) -> None:
        check_inside(path, root)
        self.path = path
        self._data = read_regular(path, _MAX_MODEL_BYTES, "a COLMAP model", SourceError)
        self._at = 0

    def take(self, count: int) -> memoryview:
        taken = memoryview(self._data)[self._at : self._at + count]
        if len(taken) < count:
            raise SourceError(f"{self.path}: the file is cut off, or is no COLMAP model")
        self._at += count
        return taken

    def unpack(self, layout: str) -> tuple[float, ...]:
        return struct.unpack(layout, self.take(struct.calcsize(layout)))

    def index(self, layout: str) -> int:
        return int(self.unpack(layout)[0])

    def name(self) -> str:
        end = self._data.find(b"\0", self._at)
        name = self.take(end - self._at if end >= 0 else len(self._data))  # beyond the end of a file that is cut off
        self.take(1)
        return name.tobytes().decode("utf-8", "surrogateescape")


def _cameras_of_bytes(data: _Bytes) -> Iterator[tuple[int, Camera]]:
    for _ in range(data.index("<Q")):  # ends with the data, however many are stated
        camera_id, model, width, height = (int(value) for value in data.unpack("<iiQQ"))
        place = f"{data.path}: camera {camera_id}"
        name = _model_name(place, model)
        parameters = data.unpack(f"<{len(COLMAP_PARAMETERS[name].split())}d")
        yield camera_id, _numbered_camera(place, name, width, height, parameters)


def _images_of_bytes(data: _Bytes) -> Iterator[ColmapImage]:
    for number in range(data.index("<Q")):
        data.take(4)  # the id of the image
        row = (f"{data.path}: image {number + 1}", "")
        pose = _pose(row, [repr(value) for value in data.unpack("<7d")])
        camera_id, name = data.index("<i"), data.name()
        yield ColmapImage(name, camera_id, pose, partial(_keypoints_of_bytes, data.take(24 * data.index("<Q"))))


# -- databases -------------------------------------------------------------------------------------


#: How a database of SQLite starts.
SQLITE = b"SQLite format 3\0"
_TABLES = frozenset({"cameras", "images", "keypoints", "matches", "two_view_geometries"})
# COLMAP: pair_id = 2147483647 * smaller image_id + larger image_id.
_MAX_IMAGES = 2_147_483_647
# Watermarks: matches that are at the same place in all images.
_WATERMARK = 7


def open_colmap_database(path: Path) -> TrackSource:
    """Open a database as a source of tracks."""
    log = path.with_name(path.name + "-wal")
    if log.exists() and log.stat().st_size:
        raise SourceError(f"{path}: is being written ({log.name} holds changes): close the program that has it open")
    try:
        # Immutable: SQLite would make files beside a database with a write-ahead log even where it only reads.
        address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(address, uri=True)) as database:
            # A view of the same name could compute for ever.
            tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not tables >= _TABLES:
                raise SourceError(f"{path}: is no database of COLMAP: its tables are others")
            return _read(path, database)
    except sqlite3.Error as error:
        raise SourceError(f"{path}: is broken, or of another version of COLMAP ({error})") from None
    except (TypeError, ValueError, OverflowError):
        raise SourceError(f"{path}: the database holds a value of an unexpected type") from None


def _read(path: Path, database: sqlite3.Connection) -> TrackSource:
    cameras = _cameras(path, database)
    listed = database.execute("SELECT image_id, name, camera_id FROM images").fetchall()
    rows = [listed[i] for i in by_name(path, [str(name) for _, name, _ in listed])]
    for image_id, name, camera_id in rows:
        if camera_id not in cameras:
            raise SourceError(f"{path}: image {image_id} ({str(name)[:100]}) has camera {camera_id}, which is missing")
    camera, kept, notes = common_camera([cameras[camera_id][0] for _, _, camera_id in rows], str(path))
    rows = [row for row, keep in zip(rows, kept, strict=True) if keep]
    if camera is None:
        raise SourceError(f"{path}: holds no image")
    is_calibrated = all(cameras[camera_id][1] for _, _, camera_id in rows)
    if not is_calibrated:
        notes = (*notes, "the focal length of the database is no calibration (prior_focal_length is 0): it is not used")
    index = {int(image_id): i for i, (image_id, _, _) in enumerate(rows)}
    table, chain_notes = chain_matches(_keypoints(path, database, index), _matches(path, database, index), str(path))
    names = tuple(str(name) for _, name, _ in rows)
    size, notes = (camera.width, camera.height), (*notes, *chain_notes)
    calibration = camera if is_calibrated else None
    return track_source(path, "colmap-database", names, size, table, camera=calibration, notes=notes)


def _array(place: str, rows: int, columns: int, data: bytes | None, dtype: str) -> Floats:
    """The first two columns of a blob of numbers; None stands for no row."""
    blob = data or b""
    if rows < 0 or columns < 2 or len(blob) != rows * columns * np.dtype(dtype).itemsize:
        raise SourceError(f"{place}: {len(blob)} bytes are no {rows}x{columns} numbers")
    return np.frombuffer(blob, dtype).reshape(rows, columns)[:, :2].astype(float)


def _cameras(path: Path, database: sqlite3.Connection) -> dict[int, tuple[Camera, bool]]:
    """The cameras, and whether the focal length of each is known."""
    cameras = {}
    query = "SELECT camera_id, model, width, height, params, prior_focal_length FROM cameras"
    for camera_id, model, width, height, blob, prior in database.execute(query):
        place = f"{path}: camera {camera_id}"
        parameters = np.frombuffer(blob or b"", "<f8").tolist()
        camera = _numbered_camera(place, _model_name(place, int(model)), int(width), int(height), parameters)
        cameras[int(camera_id)] = camera, bool(prior)
    return cameras


def _keypoints(path: Path, database: sqlite3.Connection, index: dict[int, int]) -> list[Floats]:
    """The keypoints of each image, with pixel centres at integer coordinates."""
    keypoints = [np.zeros((0, 2)) for _ in index]
    for image_id, rows, columns, data in database.execute("SELECT image_id, rows, cols, data FROM keypoints"):
        if image_id in index:
            place = f"{path}: keypoints of image {image_id}"
            points = _array(place, rows, columns, data, "<f4")
            if not np.isfinite(points).all():
                raise SourceError(f"{place}: a position is not finite")
            keypoints[index[image_id]] = points - 0.5
    return keypoints


def _matches(path: Path, database: sqlite3.Connection, index: dict[int, int]) -> Iterator[PairMatches]:
    """The verified matches of each pair, or the raw ones where no pair is verified."""
    verified = f"FROM two_view_geometries WHERE rows > 0 AND config != {_WATERMARK}"
    (count,) = database.execute(f"SELECT COUNT(*) {verified}").fetchone()
    query = f"SELECT pair_id, rows, cols, data {verified if count else 'FROM matches WHERE rows > 0'}"
    for pair_id, rows, columns, data in database.execute(query + " ORDER BY pair_id"):
        first_id, second_id = divmod(pair_id, _MAX_IMAGES)
        if first_id in index and second_id in index:
            matched = _array(f"{path}: matches of images {first_id} and {second_id}", rows, columns, data, "<u4")
            yield PairMatches(index[first_id], index[second_id], matched.astype(np.int64))
