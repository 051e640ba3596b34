"""Tracks of a pair in all views, and the choice of further views."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from slam_init.config import MapConfig
from slam_init.frontend.tracks import History, common_tracks
from slam_init.types.arrays import Floats, Ints
from slam_init.types.frame import Observations

__all__ = ["TrackTable", "further_views", "table_of", "voting_views"]


@dataclass(frozen=True, eq=False)
class TrackTable:
    """The tracks common to a pair, as seen in the pair (first two rows) and in further views.

    Attributes
    ----------
    frames : tuple of V int
    track_ids : (T,) int
    pixels : (V, T, 2) float
        NaN where a view does not see a track.
    bearings : (V, T, 3) float
    """

    frames: tuple[int, ...]
    track_ids: Ints
    pixels: Floats
    bearings: Floats


def table_of(reference: Observations, current: Observations, further: list[Observations]) -> TrackTable:
    """Gather the tracks that a pair has in common, in all views."""
    i, _ = common_tracks(reference, current)
    track_ids = reference.track_ids[i]
    views = [reference, current, *further]
    pixels = np.full((len(views), len(i), 2), np.nan)
    bearings = np.full((len(views), len(i), 3), np.nan)
    for k, view in enumerate(views):
        _, at, of = np.intersect1d(track_ids, view.track_ids, assume_unique=True, return_indices=True)
        pixels[k, at], bearings[k, at] = view.pixels[of], view.bearings[of]
    return TrackTable(tuple(view.frame for view in views), track_ids, pixels, bearings)


def further_views(
    history: History, reference: Observations, current: Observations, config: MapConfig
) -> list[Observations]:
    """Views that can vote on a pair: evenly spaced over the later part of the motion, else the nearest ones before it.

    A view close to the reference has a short baseline, hence a direction that is badly known: where the tracks moved
    less than ``min_motion_share`` of their way, a view is taken only for lack of a better one.
    """

    def motion_px(view: Observations) -> float:
        i, j = common_tracks(reference, view)
        return float(np.median(np.linalg.norm(view.pixels[j] - reference.pixels[i], axis=1)))

    between = _sharing(history.between(reference.frame, current.frame), reference, current, config.min_resected)
    if between:
        moved = np.array([motion_px(view) for view in between])
        far = config.min_motion_share * motion_px(current)
        late = [view for view, way in zip(between, moved, strict=True) if way >= far]
        views = late or [between[int(np.argmax(moved))]]
        return _evenly_spaced(views, config.max_further_views)
    earlier = _sharing(history.between(-1, reference.frame), reference, current, config.min_resected)
    return earlier[-config.max_further_views :]


def voting_views(
    history: History, reference: Observations, current: Observations, config: MapConfig
) -> list[Observations]:
    """Views for a vote between two maps: from the whole way between the pair, and what lies before it, evenly spaced.

    Other than for a map, a short baseline does no harm: such a view says little, and says so.
    """
    views = (*history.between(-1, reference.frame), *history.between(reference.frame, current.frame))
    return _evenly_spaced(_sharing(views, reference, current, config.min_resected), config.max_voting_views)


def _sharing(
    views: Iterable[Observations], reference: Observations, current: Observations, least: int
) -> list[Observations]:
    """The views that see at least so many of the tracks that a pair has in common."""
    pair_ids = np.intersect1d(reference.track_ids, current.track_ids, assume_unique=True)
    return [v for v in views if len(np.intersect1d(pair_ids, v.track_ids, assume_unique=True)) >= least]


def _evenly_spaced(views: list[Observations], at_most: int) -> list[Observations]:
    """So many of the views at most, the first and the last among them."""
    if not views:
        return []
    picks = np.unique(np.linspace(0, len(views) - 1, at_most).round().astype(int))
    return [views[k] for k in picks]
