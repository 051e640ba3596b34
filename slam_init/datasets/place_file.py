"""Reads the place of a saved map: what it is found again by."""

from __future__ import annotations

import os

import numpy as np

from slam_init.datasets.bounded import read_npz
from slam_init.datasets.text import pose_from_matrix
from slam_init.errors import SourceError
from slam_init.output.handover import FORMAT, VERSION
from slam_init.system.regular_file import user_path
from slam_init.types.frame import MOST_NUMBERS
from slam_init.types.initial_map import Keyframe
from slam_init.types.place import Place
from slam_init.types.unit_error import UnitError

_HANDOVER = "handover.npz"
#: Shapes of the arrays that are read; -1 is any number.
_ARRAYS: dict[str, tuple[int, ...]] = {
    "place_frames": (-1,), "place_poses": (-1, 4, 4), "place_points": (-1, 3), "place_noise": (),
    "place_descriptors": (-1, 128), "unit_sigma": (), "unit_by_lens": (4,), "camera_parameters": (-1,),
    "place_observation_views": (-1,), "place_observation_points": (-1,), "place_bearings": (-1, 3), "version": (),
}  # fmt: skip
#: A hundred thousand points that ten views see have 60 MB.
_MAX_BYTES = 100_000_000
#: A unit is the median depth, or a metre.
_MAX_UNITS, _MAX_NOISE_RAD = 1e9, 1.0


def load_place(path: str | os.PathLike[str]) -> Place:
    """Read what a saved map is found again by.

    Parameters
    ----------
    path : str or path
        ``handover.npz``, or the folder of a run or of a segment that has one.

    Returns
    -------
    Place

    Raises
    ------
    SourceError
        If the file cannot be read, or holds no place.
    """
    path = user_path(path)
    if path.is_dir():
        folder, path = path, path / _HANDOVER
        if not path.exists():
            raise SourceError(
                f"{folder}: holds no {_HANDOVER}: give the folder of a run, or a segment of run --restart"
            )
    arrays = read_npz(path, _ARRAYS, _MAX_BYTES, "the handover of a map")
    for name, shape in _ARRAYS.items():
        found = arrays.get(name)
        fits = found is not None and found.ndim == len(shape) and found.dtype.kind in "iuf"
        if found is None or not fits or any(n not in (-1, m) for n, m in zip(shape, found.shape, strict=True)):
            raise SourceError(f"{path}: has no {name} of a place: run again with this version")
        if name not in ("unit_sigma", "unit_by_lens") and not np.isfinite(found).all():
            raise SourceError(f"{path}: {name} has a number that is not finite: run again")
    if int(arrays["version"]) != VERSION:
        raise SourceError(f"{path}: is no {FORMAT} of version {VERSION}: run again with this version")
    frames = np.asarray(arrays["place_frames"], float)
    whole = (frames >= 0) & (frames < MOST_NUMBERS) & (frames == np.floor(frames))
    if not whole.all() or (np.diff(frames) <= 0).any():
        raise SourceError(f"{path}: place_frames are no ascending indices of frames: run again")
    poses = [
        pose_from_matrix(f"{path}: pose {k}", matrix[:3])
        for k, matrix in enumerate(np.asarray(arrays["place_poses"], float))
    ]
    views, points = (np.asarray(arrays[f"place_observation_{one}"], np.int64) for one in ("views", "points"))
    where, rays = np.asarray(arrays["place_points"], float), np.asarray(arrays["place_bearings"], float)
    described = np.asarray(arrays["place_descriptors"], float)
    inside = len(views) == len(points) == len(rays) and len(where) == len(described) and len(frames) == len(poses)
    if not inside or not ((views >= 0) & (views < len(frames)) & (points >= 0) & (points < len(where))).all():
        raise SourceError(f"{path}: the arrays of its place do not fit together: run again")
    if len(where) == 0:
        raise SourceError(f"{path}: its map has no place to be found again by: run again from images with --place")
    if len(np.unique(points)) < len(where):
        raise SourceError(f"{path}: its place has points that no view sees: run again")
    noise, farthest = float(arrays["place_noise"]), max(np.abs(where).max(), *(np.abs(pose.t).max() for pose in poses))
    if not 0 <= noise < _MAX_NOISE_RAD or farthest > _MAX_UNITS:
        raise SourceError(f"{path}: place_noise is {noise:g} rad, and its place reaches to {farthest:g}: run again")
    described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
    rays = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    indices = frames.astype(np.int64).tolist()
    keyframes = tuple(Keyframe(f, 0.0, str(f), pose) for f, pose in zip(indices, poses, strict=True))
    unit_error = UnitError(float(arrays["unit_sigma"]), np.nan_to_num(np.asarray(arrays["unit_by_lens"], float)))
    lens = tuple(np.asarray(arrays["camera_parameters"], float).tolist())
    return Place(keyframes, where, described, views, points, rays, max(noise, 1e-6), unit_error, lens)
