"""Tracks in a ``.npz`` file, for any front end: the schema is in ``docs/how-to/matches.md``.

Required: ``frame`` (M,), ``track`` (M,), ``xy`` (M, 2) and ``size`` (2,). Optional: ``names`` (F,), ``timestamps_s``
(F,), ``K`` (3, 3) with ``distortion`` and ``model``, and ``world_from_cam`` (F, 4, 4), the true poses.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_init.calibration.values import at_place
from slam_init.datasets.bounded import read_npz
from slam_init.datasets.match_chains import TrackTable
from slam_init.datasets.stamps import image_times
from slam_init.datasets.text import pose_from_matrix, trajectory
from slam_init.datasets.track_source import TrackSource, by_name, track_source
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats, as_array
from slam_init.types.camera import Camera

_REQUIRED = ("frame", "track", "xy", "size")
_OPTIONAL = ("names", "timestamps_s", "K", "distortion", "model", "world_from_cam")
# Twenty million observations have 32 bytes each.
_MAX_BYTES = 640_000_000
# Most frames without names: nine hours at 30 Hz.
_MAX_UNNAMED = 1_000_000


def is_tracks_file(path: Path) -> bool:
    """Tell whether a file is an archive of arrays, by its suffix."""
    return path.suffix.lower() == ".npz"


def open_tracks_file(path: Path) -> TrackSource:
    """Open a file of tracks."""
    arrays = read_npz(path, _REQUIRED, _MAX_BYTES, "tracks", _OPTIONAL)

    def array(name: str, kind: type, *shape: int | None) -> NDArray[Any]:
        return as_array(arrays[name], kind, shape, f"{path}: {name}", error=SourceError)

    frame, track, xy = array("frame", np.int64, None), array("track", np.int64, None), array("xy", np.float64, None, 2)
    width, height = array("size", np.int64, 2).tolist()
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
        stamps = array("timestamps_s", np.float64, len(names))
        timestamps_s, notes = image_times(stamps.tolist(), [f"{path}: timestamps_s[{i}]" for i in range(len(stamps))])
    camera: Camera | None = None
    if "K" in arrays:
        K = array("K", np.float64, 3, 3)
        distortion = array("distortion", np.float64, None).tolist() if "distortion" in arrays else []
        model = str(arrays.get("model", "radtan" if distortion else "pinhole"))
        with at_place(f"{path}: K"):
            camera = Camera(model, width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(distortion))
    source = track_source(
        path, "tracks", names, (width, height), table, camera=camera, timestamps_s=timestamps_s, notes=notes
    )
    return source if "world_from_cam" not in arrays else _with_truth(path, source, arrays["world_from_cam"])


def _names(path: Path, stated: NDArray[Any] | None, count: int) -> tuple[str, ...]:
    if stated is None:
        if count > _MAX_UNNAMED:
            raise SourceError(f"{path}: frame has the value {count - 1}: expected less than {_MAX_UNNAMED}")
        return tuple(f"frame-{i:06d}" for i in range(count))
    names = [str(name) for name in stated.ravel()]
    by_name(path, names)  # checks them; the order is that of the file
    return tuple(names)


def _with_truth(path: Path, source: TrackSource, matrices: NDArray[Any]) -> TrackSource:
    if matrices.shape != (len(source), 4, 4) or matrices.dtype.kind != "f":
        found = f"{matrices.dtype} of shape {matrices.shape}"
        raise SourceError(f"{path}: world_from_cam is {found}: expected numbers ({len(source)}, 4, 4)")
    stamped = [
        (float(source.timestamps_s[i]), pose_from_matrix(f"{path}: world_from_cam[{i}]", matrix))
        for i, matrix in enumerate(matrices.astype(float))
        if np.isfinite(matrix).all()  # NaN: unknown
    ]
    return replace(source, groundtruth=trajectory(stamped))
