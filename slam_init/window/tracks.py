"""The tracks of a window: which views and which tracks take part in the joint fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.window.joint_fit import WindowTracks

__all__ = ["MAX_TRACKS", "MAX_VIEWS", "gather_tracks"]

#: A decision needs a well-spread subset of the tracks, not all of them: the standard deviation of the direction falls
#: with the square root of their number, and 150 of 800 tracks leave 2.3 times of it.
MAX_TRACKS = 150
#: The information of more views comes from their baselines, which grow; views in between add little.
MAX_VIEWS = 12
#: The image is divided into this many cells (columns, rows); each cell gives its best tracks in turn.
_CELLS = (12, 9)


def gather_tracks(camera: Camera, views: Sequence[Observations], noise_px: float) -> WindowTracks:
    """Choose tracks that are seen in many views and spread over the image.

    Parameters
    ----------
    camera : Camera
    views : sequence of Observations
        The pair first (reference, current), then further views in any order.
    noise_px : float
        Standard deviation of a coordinate of a pixel.

    Returns
    -------
    WindowTracks
        Its first view is the reference, whose frame is the world.
    """
    track_ids, pixels, seen = _table(views)
    # A track of both views of the pair binds all views to the pair.
    score = seen.sum(axis=0) + len(views) * (seen[0] & seen[1])
    chosen = _spread(camera, pixels, seen, score)
    frames = tuple(view.frame for view in views)
    return WindowTracks.gather(
        camera, frames, track_ids[chosen], pixels[:, chosen], seen[:, chosen], max(noise_px, 1e-3)
    )


def _table(views: Sequence[Observations]) -> tuple[Ints, Floats, Bools]:
    """Track ids (T,), pixels (V, T, 2) and visibility (V, T) of the tracks that two views or more see."""
    track_ids, counts = np.unique(np.concatenate([view.track_ids for view in views]), return_counts=True)
    track_ids = track_ids[counts >= 2]
    pixels = np.zeros((len(views), len(track_ids), 2))
    seen = np.zeros((len(views), len(track_ids)), bool)
    for k, view in enumerate(views):
        _, at, of = np.intersect1d(track_ids, view.track_ids, assume_unique=True, return_indices=True)
        pixels[k, at], seen[k, at] = view.pixels[of], True
    return track_ids, pixels, seen


def _spread(camera: Camera, pixels: Floats, seen: Bools, score: Ints) -> Ints:
    """Positions (ascending) of at most 150 tracks: the best of each cell, then the second of each cell, and so on."""
    count = pixels.shape[1]
    if count <= MAX_TRACKS:
        return np.arange(count)
    first = pixels[np.argmax(seen, axis=0), np.arange(count)]
    columns, rows = (np.clip(first / (camera.width, camera.height), 0, 0.999) * _CELLS).astype(int).T
    cell = columns * _CELLS[1] + rows
    order = np.lexsort((np.arange(count), -score, cell))
    starts = np.concatenate([[True], np.diff(cell[order]) != 0])
    run = np.arange(count) - np.maximum.accumulate(np.where(starts, np.arange(count), 0))
    rank = np.empty(count, np.int64)
    rank[order] = run
    return np.sort(np.lexsort((np.arange(count), -score, rank))[:MAX_TRACKS])
