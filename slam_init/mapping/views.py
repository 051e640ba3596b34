"""The tracks of a pair in several views, and the choice of further views for a pair."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.config import MapConfig
from slam_init.types.arrays import Floats, Ints
from slam_init.types.frame import Observations
from slam_init.types.history import History


@dataclass(frozen=True, eq=False)
class TrackTable:
    """The tracks that a pair has in common, as the pair (first two rows) and further views see them."""

    #: Absolute frame index of each row.
    frames: tuple[int, ...]
    #: (T,)
    track_ids: Ints
    #: (V, T, 2) Raw pixels; NaN where a view does not see a track.
    pixels: Floats
    #: (V, T, 3) Unit rays in the camera frames; NaN where a view does not see a track.
    bearings: Floats


def seen_by(views: Sequence[Observations], track_ids: Ints) -> tuple[Floats, Floats]:
    """Pixels (V, T, 2) and rays (V, T, 3) of tracks (T,) in views; NaN where a view does not see a track."""
    pixels = np.full((len(views), len(track_ids), 2), np.nan)
    bearings = np.full((len(views), len(track_ids), 3), np.nan)
    for k, view in enumerate(views):
        _, at, of = np.intersect1d(track_ids, view.track_ids, assume_unique=True, return_indices=True)
        pixels[k, at], bearings[k, at] = view.pixels[of], view.bearings[of]
    return pixels, bearings


def table_of(reference: Observations, current: Observations, further: list[Observations]) -> TrackTable:
    """Gather the tracks that a pair has in common, in the pair and in further views."""
    track_ids = np.intersect1d(reference.track_ids, current.track_ids, assume_unique=True)
    views = [reference, current, *further]
    return TrackTable(tuple(view.frame for view in views), track_ids, *seen_by(views, track_ids))


def further_views(
    history: History,
    reference: Observations,
    current: Observations,
    config: MapConfig,
    most: int,
    before: Collection[int] = (),
    *,
    later_share: float | None = None,
) -> list[Observations]:
    """Choose further views for the motions of a pair, spread over all views between and before the pair.

    Views with a short baseline are no disadvantage: all motions predict nearly the same for them.

    * ``before``: Frames that stay where they still share the tracks of the pair: their poses are known.
    * ``later_share``: Share of the pair's tracks from which on views after it are chosen as well; by default none are.
    * Returns: Each sees at least ``min_resected`` of the tracks that the pair has in common.
    """
    track_ids = np.intersect1d(reference.track_ids, current.track_ids, assume_unique=True)
    least, later = config.min_resected, math.inf
    if later_share is not None:
        later = max(least, math.ceil(later_share * len(track_ids)))
    sharing = [
        view
        for view in history
        if view.frame not in (reference.frame, current.frame)
        and np.isin(view.track_ids, track_ids, assume_unique=True).sum()
        >= (least if view.frame < current.frame else later)
    ]
    return [sharing[k] for k in _spread([view.frame for view in sharing], most, before)]


def _spread(frames: list[int], most: int, before: Collection[int]) -> list[int]:
    """Places of at most so many of some ascending frames: the first, the last, and those of before as far as they fit.

    Frames that are new fill the widest gaps, and frames leave where they stand closest.
    """
    if len(frames) <= most:
        return list(range(len(frames)))
    chosen = sorted({0, len(frames) - 1, *(k for k, frame in enumerate(frames) if frame in before)})
    while len(chosen) < most:
        gap = max(range(len(chosen) - 1), key=lambda k: frames[chosen[k + 1]] - frames[chosen[k]])
        low, high = chosen[gap], chosen[gap + 1]
        if high - low < 2:  # the widest gap holds no other frame
            low, high = max(itertools.pairwise(chosen), key=lambda pair: pair[1] - pair[0])
        chosen = sorted({*chosen, (low + high) // 2})
    while len(chosen) > most:
        inner = range(1, len(chosen) - 1)
        del chosen[min(inner, key=lambda k: frames[chosen[k + 1]] - frames[chosen[k - 1]])]
    return chosen
