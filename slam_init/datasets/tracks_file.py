"""Tracks in a ``.npz`` file, for any front end: the schema is in ``docs/matches.md``.

Required: ``frame`` (M,), ``track`` (M,), ``xy`` (M, 2) and ``size`` (2,). Optional: ``names`` (F,), ``timestamps_s``
(F,), ``K`` (3, 3) with ``distortion`` and ``model``, and ``world_from_cam`` (F, 4, 4), the true poses.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_init.datasets.bounded import checked_array, read_npz
from slam_init.datasets.match_chains import TrackTable
from slam_init.datasets.stamps import image_times
from slam_init.datasets.text import pose_from_matrix, trajectory
from slam_init.datasets.track_source import TrackSource, by_name, track_source
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera

_REQUIRED = ("frame", "track", "xy", "size")
_ARRAYS = (*_REQUIRED, "names", "timestamps_s", "K", "distortion", "model", "world_from_cam")
# Twenty million observations have 32 bytes each.
_MAX_BYTES = 640_000_000
# Most frames without names: nine hours at 30 Hz.
_MAX_UNNAMED = 1_000_000

_Arrays = dict[str, NDArray[np.generic]]


def is_tracks_file(path: Path) -> bool:
    """Tell whether a file is an archive of arrays, by its suffix."""
    return path.suffix.lower() == ".npz"


def open_tracks_file(path: Path) -> TrackSource:
    """Open a file of tracks."""
    arrays: _Arrays = read_npz(path, _ARRAYS, _MAX_BYTES, "tracks")
    frame, track = (_whole(path, arrays, name, (-1,)) for name in ("frame", "track"))
    xy = _real(path, arrays, "xy", (-1, 2))
    width, height = _whole(path, arrays, "size", (2,)).tolist()
    if not len(frame) == len(track) == len(xy):
        raise SourceError(f"{path}: frame, track and xy have {len(frame)}, {len(track)} and {len(xy)} rows")
    names = _names(path, arrays, int(frame.max(initial=-1)) + 1)
    if len(frame) and (frame.min() < 0 or frame.max() >= len(names)):
        raise SourceError(f"{path}: frame has the value {frame.max()}, but there are {len(names)} names")
    order = np.lexsort((track, frame))
    table = TrackTable(frame[order], track[order], xy[order])
    if ((np.diff(table.frames) == 0) & (np.diff(table.track_ids) == 0)).any():
        raise SourceError(f"{path}: a track is in a frame twice: give each track once in a frame")
    timestamps_s: Floats | None = None
    notes: tuple[str, ...] = ()
    if "timestamps_s" in arrays:
        stamps = _real(path, arrays, "timestamps_s", (len(names),))
        timestamps_s, notes = image_times(stamps.tolist(), [f"{path}: timestamps_s[{i}]" for i in range(len(stamps))])
    camera = _camera(path, arrays, (width, height))
    source = track_source(
        path, "tracks", names, (width, height), table, camera=camera, timestamps_s=timestamps_s, notes=notes
    )
    return source if "world_from_cam" not in arrays else _with_truth(path, source, arrays)


def _whole(path: Path, arrays: _Arrays, name: str, shape: tuple[int, ...]) -> Ints:
    array = checked_array(path, arrays, name, shape, "iu", "whole numbers")
    if (array > np.iinfo(np.int64).max).any():
        raise SourceError(f"{path}: {name} holds a number above 2^63")
    return np.asarray(array, np.int64)


def _real(path: Path, arrays: _Arrays, name: str, shape: tuple[int, ...]) -> Floats:
    return np.asarray(checked_array(path, arrays, name, shape, "iuf", "numbers"), float)


def _names(path: Path, arrays: _Arrays, count: int) -> tuple[str, ...]:
    if "names" not in arrays:
        if count > _MAX_UNNAMED:
            raise SourceError(f"{path}: frame has the value {count - 1}: expected less than {_MAX_UNNAMED}")
        return tuple(f"frame-{i:06d}" for i in range(count))
    names = [str(name) for name in checked_array(path, arrays, "names", (-1,), "U", "text")]
    by_name(path, names)  # checks them; the order is that of the file
    return tuple(names)


def _camera(path: Path, arrays: _Arrays, size: tuple[int, int]) -> Camera | None:
    if "K" not in arrays:
        return None
    K = _real(path, arrays, "K", (3, 3))
    distortion = _real(path, arrays, "distortion", (-1,)).tolist() if "distortion" in arrays else []
    model = str(arrays["model"]) if "model" in arrays else ("radtan" if distortion else "pinhole")
    try:
        return Camera(model, *size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), tuple(distortion))
    except CalibrationError as error:
        raise CalibrationError(f"{path}: K: {error}") from None


def _with_truth(path: Path, source: TrackSource, arrays: _Arrays) -> TrackSource:
    shape, stamped = (len(source), 4, 4), []
    matrices = checked_array(path, arrays, "world_from_cam", shape, "f", "numbers", finite=False)
    for i, matrix in enumerate(matrices.astype(float)):
        if np.isfinite(matrix).all():  # NaN: unknown
            pose = pose_from_matrix(f"{path}: world_from_cam[{i}]", matrix)
            stamped.append((float(source.timestamps_s[i]), pose))
    return replace(source, groundtruth=trajectory(stamped))
