"""A COLMAP ``database.db`` as a source of tracks: keypoints and matches of any features and matcher.

COLMAP, hloc (SuperPoint, LightGlue, LoFTR) and RoMa write such databases. The verified matches of
``two_view_geometries`` are taken; where there are none, ``matches``. The camera is that of the table ``cameras`` where
its focal length is marked as known (``prior_focal_length``). Pixel centres of COLMAP lie at .5.

The file is read and never written: no journal and no shared memory is made beside it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from slam_init.datasets.colmap_files import colmap_camera
from slam_init.datasets.match_chains import PairMatches, chain_matches
from slam_init.datasets.posed_images import common_camera
from slam_init.datasets.track_source import TrackSource, by_name, track_source
from slam_init.errors import SourceError
from slam_init.system.regular_file import open_regular
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

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
