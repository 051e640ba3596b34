"""COLMAP's models (``cameras`` and ``images``, text or binary), and its ``database.db`` as a source of tracks.

A pose of COLMAP is ``cam_from_world``, with the axes of this project. Its pixel centres lie at .5; half a pixel is
subtracted from principal points, as in :func:`slam_init.calibration.formats.parse_colmap`, and from keypoints.

COLMAP, hloc (SuperPoint, LightGlue, LoFTR) and RoMa write databases. The verified matches of ``two_view_geometries``
are taken; where there are none, ``matches``. The camera is that of the table ``cameras`` where its focal length is
marked as known (``prior_focal_length``). A database is read and never written: no journal and no shared memory is made
beside it.
"""

from __future__ import annotations

import os
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slam_init.calibration.formats import parse_colmap
from slam_init.calibration.models import COLMAP_PARAMETERS, NUMBERED
from slam_init.datasets.match_chains import PairMatches, chain_matches
from slam_init.datasets.posed_images import common_camera
from slam_init.datasets.text import Row, numbers, pose_from_quaternion, read_lines, read_rows
from slam_init.datasets.track_source import TrackSource, by_name, track_source
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside, open_regular, read_regular
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

# -- models ----------------------------------------------------------------------------------------


# A thousand images with ten thousand points each have 240 MB.
_MAX_IMAGES_BYTES = 2_000_000_000
_MAX_CAMERAS_BYTES = 100_000_000


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """An image of a model."""

    #: Relative to the image folder.
    name: str
    camera_id: int
    cam_from_world: Pose
    #: (N, 2) Keypoints, pixel centres at integer coordinates; none where they were not read.
    pixels: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    #: (N,) Their points; -1 where there is none.
    point_ids: Ints = field(default_factory=lambda: np.zeros(0, np.int64))


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


def read_images(path: Path, root: Path, *, observations: bool = False) -> list[ColmapImage]:
    """Read ``images.txt`` or ``images.bin``.

    * ``observations``: Whether the keypoints are read as well; by default they are skipped.
    """
    if path.suffix == ".bin":
        return _read_images_bin(path, root, observations=observations)
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
        points = next(lines, None)  # perhaps none
        seen = _keypoints_of_line(points) if observations and points is not None else ()
        images.append(ColmapImage(fields[9], _index(row, fields[8]), pose, *seen))
    return images


def _keypoints_of_line(row: Row) -> tuple[Floats, Ints]:
    """The keypoints of an image, and their points: X, Y and POINT3D_ID for each."""
    fields = row[1].split()
    values = np.array(numbers(row, fields, len(fields), "X, Y and POINT3D_ID for each point"))
    if len(values) % 3:
        raise SourceError(f"{row[0]}: expected X, Y and POINT3D_ID for each point, found {len(values)} numbers")
    table = values.reshape(-1, 3)
    return table[:, :2] - 0.5, table[:, 2].astype(np.int64)


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

    def keypoints(self, count: int) -> tuple[Floats, Ints]:
        """The keypoints of an image, and their points; -1 for none."""
        start = self._at
        self.skip(24 * count)
        rows = np.frombuffer(self._data[start : self._at], [("xy", "<f8", 2), ("point", "<i8")])
        return rows["xy"] - 0.5, rows["point"].astype(np.int64)

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


def _read_images_bin(path: Path, root: Path, *, observations: bool) -> list[ColmapImage]:
    data = _Bytes(path, root, _MAX_IMAGES_BYTES)
    images = []
    for number in range(data.index("<Q")):
        data.skip(4)  # the id of the image
        row = (f"{path}: image {number + 1}", "")
        values = [repr(value) for value in data.unpack("<7d")]
        qw, qx, qy, qz, *t = numbers(row, values, 7, "a finite pose")
        camera_id = data.index("<i")
        name = data.name()
        count = data.index("<Q")
        seen = data.keypoints(count) if observations else ()
        if not observations:
            data.skip(24 * count)
        images.append(ColmapImage(name, camera_id, pose_from_quaternion(row, t, [qw, qx, qy, qz]), *seen))
    return images


# -- databases -------------------------------------------------------------------------------------


_MAGIC = b"SQLite format 3\0"
_TABLES = frozenset({"cameras", "images", "keypoints", "matches", "two_view_geometries"})
# COLMAP: pair_id = 2147483647 * smaller image_id + larger image_id.
_MAX_IMAGES = 2_147_483_647
# Watermarks: matches that are at the same place in all images.
_WATERMARK = 7

# A row holds the keypoints of an image: a million of them with six numbers each have 24 MB.
_MAX_ROW_BYTES = 100_000_000
_MAX_TOTAL_BYTES = 4_000_000_000
# Steps of the virtual machine of SQLite. A row takes about ten; a query that takes more than this is no plain one.
_MAX_STEPS = 500_000_000
_STEP = 100_000


def is_colmap_database(path: Path) -> bool:
    """Tell whether a file is a database of COLMAP, by its content or the suffix ``.db``."""
    if path.suffix.lower() == ".db":
        return True
    if not _is_sqlite(path):
        return False
    with closing(_connect(path)) as database:
        return _is_colmap(path, database)


def open_colmap_database(path: Path) -> TrackSource:
    """Open a database as a source of tracks."""
    if not _is_sqlite(path):
        raise SourceError(f"{path}: is no SQLite database: give a database of COLMAP")
    with closing(_connect(path)) as database:
        if not _is_colmap(path, database):
            raise SourceError(f"{path}: is no database of COLMAP: its tables are others")
        try:
            return _read(path, _Reader(path, database))
        except sqlite3.Error as error:
            raise SourceError(f"{path}: the database is broken, or of another version of COLMAP ({error})") from None
        except (TypeError, ValueError, OverflowError):
            raise SourceError(f"{path}: the database holds a value of an unexpected type") from None


def _is_sqlite(path: Path) -> bool:
    with open_regular(path, SourceError) as file:
        return file.read(len(_MAGIC)) == _MAGIC


def _connect(path: Path) -> sqlite3.Connection:
    log = path.with_name(path.name + "-wal")
    if log.exists() and log.stat().st_size:
        raise SourceError(f"{path}: is being written ({log.name} holds changes): close the program that has it open")
    try:
        # Immutable: SQLite would make files beside a database with a write-ahead log even where it only reads.
        database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    except (sqlite3.Error, ValueError) as error:
        raise SourceError(f"{path}: cannot be opened ({error})") from None
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_ROW_BYTES)
    steps = iter(range(_MAX_STEPS // _STEP))
    database.set_progress_handler(lambda: next(steps, None) is None, _STEP)
    database.text_factory = lambda data: data.decode("utf-8", "surrogateescape")
    return database


def _is_colmap(path: Path, database: sqlite3.Connection) -> bool:
    """Whether the tables are those of COLMAP. A view of the same name could compute anything."""
    try:
        database.execute("PRAGMA trusted_schema = OFF")
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except (sqlite3.Error, ValueError) as error:  # ValueError: a schema that is no UTF-8
        raise SourceError(f"{path}: the database is broken ({error})") from None
    return tables >= _TABLES


class _Reader:
    """Reads the blobs of a database, up to a total size."""

    def __init__(self, path: Path, database: sqlite3.Connection) -> None:
        self.path = path
        self.database = database
        self._left = _MAX_TOTAL_BYTES

    def array(self, place: str, rows: int, columns: int, data: bytes | None, dtype: str) -> Floats:
        """A blob of ``rows`` x ``columns`` numbers; None stands for no row."""
        blob = data or b""
        self._left -= len(blob)
        if self._left < 0:
            raise SourceError(f"{self.path}: holds more than {_MAX_TOTAL_BYTES // 10**9} GB: give fewer images")
        if rows < 0 or columns < 2 or len(blob) != rows * columns * np.dtype(dtype).itemsize:
            raise SourceError(f"{self.path}: {place}: {len(blob)} bytes are no {rows}x{columns} numbers")
        return np.frombuffer(blob, dtype).reshape(rows, columns)[:, :2].astype(float)


def _read(path: Path, reader: _Reader) -> TrackSource:
    cameras, known = _cameras(path, reader.database)
    listed = reader.database.execute("SELECT image_id, name, camera_id FROM images").fetchall()
    order = by_name(path, [str(name) for _, name, _ in listed])
    rows = [listed[i] for i in order]
    for image_id, name, camera_id in rows:
        if camera_id not in cameras:
            raise SourceError(f"{path}: image {image_id} ({str(name)[:100]}) has camera {camera_id}, which is missing")
    camera, kept, notes = common_camera([cameras[camera_id] for _, _, camera_id in rows], str(path))
    rows = [row for row, keep in zip(rows, kept, strict=True) if keep]
    if camera is None:
        raise SourceError(f"{path}: holds no image")
    if not all(known[camera_id] for _, _, camera_id in rows):
        notes = (*notes, "the focal length of the database is no calibration (prior_focal_length is 0): it is not used")
    index = {int(image_id): i for i, (image_id, _, _) in enumerate(rows)}
    keypoints = _keypoints(reader, index)
    table, dropped = chain_matches(keypoints, _matches(reader, index), str(path))
    if dropped:
        notes = (*notes, f"{dropped} matches would join two points of one image in a track, and are dropped")
    names = tuple(str(name) for _, name, _ in rows)
    size = camera.width, camera.height
    calibrated = camera if all(known[camera_id] for _, _, camera_id in rows) else None
    return track_source(path, "colmap-database", names, size, table, camera=calibrated, notes=notes)


def _cameras(path: Path, database: sqlite3.Connection) -> tuple[dict[int, Camera], dict[int, bool]]:
    """The cameras, and whether the focal length of each is known."""
    cameras, known = {}, {}
    query = "SELECT camera_id, model, width, height, params, prior_focal_length FROM cameras"
    for camera_id, model, width, height, blob, prior in database.execute(query):
        place = f"{path}: camera {camera_id}"
        if len(blob or b"") % 8:
            raise SourceError(f"{place}: its parameters are no numbers")
        parameters = np.frombuffer(blob or b"", "<f8").tolist()
        cameras[int(camera_id)] = colmap_camera(place, int(model), int(width), int(height), parameters)
        known[int(camera_id)] = bool(prior)
    return cameras, known


def _keypoints(reader: _Reader, index: dict[int, int]) -> list[Floats]:
    """The keypoints of each image, with pixel centres at integer coordinates."""
    keypoints = [np.zeros((0, 2)) for _ in index]
    for image_id, rows, columns, data in reader.database.execute("SELECT image_id, rows, cols, data FROM keypoints"):
        if image_id in index:
            points = reader.array(f"keypoints of image {image_id}", rows, columns, data, "<f4")
            if not np.isfinite(points).all():
                raise SourceError(f"{reader.path}: keypoints of image {image_id}: a position is not finite")
            keypoints[index[image_id]] = points - 0.5
    return keypoints


def _matches(reader: _Reader, index: dict[int, int]) -> Iterator[PairMatches]:
    """The verified matches of each pair, or the raw ones where no pair is verified."""
    verified = f"FROM two_view_geometries WHERE rows > 0 AND config != {_WATERMARK}"
    (count,) = reader.database.execute(f"SELECT COUNT(*) {verified}").fetchone()
    query = f"SELECT pair_id, rows, cols, data {verified if count else 'FROM matches WHERE rows > 0'}"
    for pair_id, rows, columns, data in reader.database.execute(query + " ORDER BY pair_id"):
        second_id = pair_id % _MAX_IMAGES
        first_id = (pair_id - second_id) // _MAX_IMAGES
        if first_id in index and second_id in index:
            matched = reader.array(f"matches of images {first_id} and {second_id}", rows, columns, data, "<u4")
            yield PairMatches(index[first_id], index[second_id], matched.astype(np.int64))
