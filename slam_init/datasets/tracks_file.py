"""Tracks in a ``.npz`` file, for any front end: the schema is in ``docs/matches.md``.

Required: ``frame`` (M,), ``track`` (M,), ``xy`` (M, 2) and ``size`` (2,). Optional: ``names`` (F,), ``timestamps_s``
(F,), ``K`` (3, 3) with ``distortion`` and ``model``, and ``world_from_cam`` (F, 4, 4), the true poses.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_init.datasets.bounded import read_npz
from slam_init.datasets.image_files import MAX_FRAMES
from slam_init.datasets.match_chains import MAX_MATCHES, TrackTable
from slam_init.datasets.stamps import image_times
from slam_init.datasets.text import pose_from_matrix, trajectory
from slam_init.datasets.track_source import TrackSource, by_name, track_source
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Trajectory

_ARRAYS = (
    "frame", "track", "xy", "size", "names", "timestamps_s", "K", "distortion", "model", "world_from_cam",
)  # fmt: skip
_REQUIRED = _ARRAYS[:4]
# Observations are as many as matches at most; each has 32 bytes.
_MAX_BYTES = 32 * MAX_MATCHES


def is_tracks_file(path: Path) -> bool:
    """Tell whether a file is an archive of arrays, by its suffix."""
    return path.suffix.lower() == ".npz"


def open_tracks_file(path: Path) -> TrackSource:
    """Open a file of tracks."""
    arrays = read_npz(path, _ARRAYS, _MAX_BYTES, "tracks")
    missing = [name for name in _REQUIRED if name not in arrays]
    if missing:
        raise SourceError(f"{path}: has no array {missing[0]}: a file of tracks has {', '.join(_REQUIRED)}")
    frame, track = (_whole(path, arrays[name], name) for name in ("frame", "track"))
    xy = _real(path, arrays["xy"], "xy", (-1, 2))
    width, height = _whole(path, arrays["size"], "size").tolist()[:2] if arrays["size"].shape == (2,) else (0, 0)
    if not len(frame) == len(track) == len(xy):
        raise SourceError(f"{path}: frame, track and xy have {len(frame)}, {len(track)} and {len(xy)} rows")
    names = _names(path, arrays.get("names"), int(frame.max(initial=-1)) + 1)
    if len(frame) and (frame.min() < 0 or frame.max() >= len(names)):
        raise SourceError(f"{path}: frame has the value {frame.max()}, but there are {len(names)} names")
    order = np.lexsort((track, frame))
    table = TrackTable(frame[order], track[order], xy[order])
    if ((np.diff(table.frames) == 0) & (np.diff(table.track_ids) == 0)).any():
        raise SourceError(f"{path}: a track is in a frame twice: give each track once in a frame")
    timestamps_s: Floats | None = None
    notes: tuple[str, ...] = ()
    if "timestamps_s" in arrays:
        stamps = _real(path, arrays["timestamps_s"], "timestamps_s", (len(names),))
        places = [f"{path}: timestamps_s[{i}]" for i in range(len(stamps))]
        timestamps_s, notes = image_times(stamps.tolist(), places)
    source = track_source(
        path,
        "tracks",
        names,
        (int(width), int(height)),
        table,
        camera=_camera(path, arrays, (int(width), int(height))),
        timestamps_s=timestamps_s,
        notes=notes,
    )
    return source if "world_from_cam" not in arrays else _with_truth(path, source, arrays["world_from_cam"])


def _whole(path: Path, array: NDArray[np.generic], name: str) -> Ints:
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise SourceError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}: expected whole numbers in one dimension"
        )
    if array.dtype.kind == "u" and array.size and int(np.asarray(array, np.uint64).max()) > np.iinfo(np.int64).max:
        raise SourceError(f"{path}: {name} holds a number above 2^63")
    return np.asarray(array, np.int64)


def _real(path: Path, array: NDArray[np.generic], name: str, shape: tuple[int, ...]) -> Floats:
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in "iuf":
        expected = ", ".join("M" if n < 0 else str(n) for n in shape)
        raise SourceError(f"{path}: {name} is {array.dtype} of shape {array.shape}: expected numbers ({expected})")
    values = np.asarray(array, float)
    if not np.isfinite(values).all():
        raise SourceError(f"{path}: {name} holds a number that is not finite")
    return values


def _names(path: Path, array: NDArray[np.generic] | None, count: int) -> tuple[str, ...]:
    if array is None:
        if count > MAX_FRAMES:
            raise SourceError(f"{path}: frame has the value {count - 1}: expected less than {MAX_FRAMES}")
        return tuple(f"frame-{i:06d}" for i in range(count))
    if array.ndim != 1 or array.dtype.kind != "U":
        raise SourceError(f"{path}: names is {array.dtype} of shape {array.shape}: expected text in one dimension")
    names = [str(name) for name in array]
    by_name(path, names)  # checks them; the order is that of the file
    return tuple(names)


def _camera(path: Path, arrays: dict[str, NDArray[np.generic]], size: tuple[int, int]) -> Camera | None:
    if "K" not in arrays:
        return None
    K = _real(path, arrays["K"], "K", (3, 3))
    distortion = _real(path, arrays["distortion"], "distortion", (-1,)).tolist() if "distortion" in arrays else []
    model = str(arrays["model"]) if "model" in arrays else ("radtan" if distortion else "pinhole")
    try:
        return Camera(model, *size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), tuple(distortion))
    except CalibrationError as error:
        raise CalibrationError(f"{path}: K: {error}") from None


def _with_truth(path: Path, source: TrackSource, array: NDArray[np.generic]) -> TrackSource:
    if array.shape != (len(source), 4, 4) or array.dtype.kind != "f":
        raise SourceError(
            f"{path}: world_from_cam is {array.dtype} of shape {array.shape}: expected ({len(source)}, 4, 4)"
        )
    stamped = []
    for i, matrix in enumerate(np.asarray(array, float)):
        if np.isfinite(matrix).all():  # NaN: unknown
            pose = pose_from_matrix(f"{path}: world_from_cam[{i}]", matrix)
            stamped.append((float(source.timestamps_s[i]), pose))
    truth: Trajectory | None = trajectory(stamped)
    return replace(source, groundtruth=truth)
