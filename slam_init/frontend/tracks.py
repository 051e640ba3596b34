"""Features and tracks: which image points of different frames are the same point of the world.

Video is followed by Lucas-Kanade flow from frame to frame, with a forward-backward check. Where the flow loses more
than half of its tracks in one step (photographs, a cut, a fast pan), SIFT descriptors link the frame to the last few
instead, and whichever of the two links more wins. Both feed the same tracks: nothing after this module knows which.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.errors import SlamInitError
from slam_init.frontend.sift import detect_sift, first_per_cell, match_descriptors
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations

__all__ = ["History", "Tracker", "common_tracks"]


def common_tracks(a: Observations, b: Observations) -> tuple[Ints, Ints]:
    """Positions in a and in b of the tracks that both see, in order of track id."""
    _, ia, ib = np.intersect1d(a.track_ids, b.track_ids, assume_unique=True, return_indices=True)
    return ia, ib


class History:
    """Observations of the last ``limit`` frames, and of older ones that are still asked for."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._frames: dict[int, Observations] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, frame: int) -> Observations:
        return self._frames[frame]

    def put(self, observations: Observations) -> None:
        """Add a frame, or replace it by a richer version of itself."""
        self._frames[observations.frame] = observations

    def take(self, observations: Observations, revised: Iterable[Observations] = ()) -> None:
        """Check the tracks of the next frame and add them; replace earlier frames by richer versions.

        Raises
        ------
        SlamInitError
            Where the arrays do not belong together, a bearing is not finite, or the frame is not the next one.
        """
        for one in (observations, *revised):
            _check(one)
        newest = max(self._frames, default=-1)
        # The tracker has put its own observations here already.
        again = observations.frame == newest and self._frames[newest] is not observations
        if observations.frame < max(newest, 0) or again:
            raise SlamInitError(
                f"frame {observations.frame} comes after frame {newest}: feed frames in ascending order"
            )
        self._frames |= {one.frame: one for one in revised if one.frame in self._frames}
        self.put(observations)

    def forget(self, keep: Iterable[int]) -> None:
        """Drop what is older than the limit, except for the frames in ``keep``."""
        wanted = set(keep)
        newest = max(self._frames, default=0)
        for frame in [f for f in self._frames if f <= newest - self._limit and f not in wanted]:
            del self._frames[frame]

    def between(self, first: int, last: int) -> list[Observations]:
        """The frames strictly between two absolute indices, in time order."""
        return [o for f, o in sorted(self._frames.items()) if first < f < last]


def _check(observations: Observations) -> None:
    count, name = len(observations), f"frame {observations.frame}"
    shapes = (observations.track_ids.shape, observations.pixels.shape, observations.bearings.shape)
    if shapes != ((count,), (count, 2), (count, 3)):
        raise SlamInitError(f"{name}: track ids, pixels and bearings of shapes {shapes}: give (N,), (N, 2) and (N, 3)")
    if len(observations.colors) not in (0, count):
        raise SlamInitError(f"{name}: {len(observations.colors)} colors for {count} tracks: give one for each, or none")
    if not (np.diff(observations.track_ids) > 0).all():
        raise SlamInitError(f"{name}: track ids must be strictly increasing: sort them, and give each once")
    if not (np.isfinite(observations.bearings).all() and np.isfinite(observations.pixels).all()):
        raise SlamInitError(f"{name}: a pixel or bearing is not finite: leave such tracks out")


@dataclass(frozen=True, eq=False)
class _SiftFrame:
    """Keypoints of one frame, their descriptors, and the track of each (-1: none yet; updated in place)."""

    frame: int
    pixels: Floats
    descriptors: Floats
    track_ids: Ints


class Tracker:
    """Follows features through the frames that it is fed, in order, and keeps their history.

    Parameters
    ----------
    camera : Camera
        Turns pixels into bearings.
    config : TrackingConfig
    history_limit : int
        How many frames to remember.

    Attributes
    ----------
    history : History
    revised : tuple of Observations
        Earlier frames that the last call of :meth:`track` enriched.
    """

    def __init__(self, camera: Camera, config: TrackingConfig, history_limit: int = 150) -> None:
        self.history = History(history_limit)
        self.revised: tuple[Observations, ...] = ()
        self._camera = camera
        self._config = config
        self._last: Observations | None = None
        self._last_gray: Image | None = None
        self._sift_frames: deque[_SiftFrame] = deque(maxlen=config.sift_frames)
        self._next_id = 0

    def track(self, frame: Frame) -> Observations:
        """Follow the tracks into the next frame, and start new ones where some were lost.

        A link by descriptors finds tracks that earlier frames did not know of: the history of those is enriched.
        """
        gray = frame.gray
        self.revised = ()
        ids, pixels, by_descriptors = self._link(frame.index, gray)
        wanted = self._config.max_tracks
        if not by_descriptors and len(ids) < (1 - self._config.refill_share) * wanted:
            new = self._detect(gray, pixels, wanted - len(ids))
            ids = np.concatenate([ids, self._new_ids(len(new))])
            pixels = np.concatenate([pixels, new])
        bearings = self._camera.bearings(pixels)
        # A pixel beyond the field of view of the lens model has no ray.
        order = np.argsort(ids)
        order = order[np.isfinite(bearings[order]).all(axis=1)]
        self._last = Observations(
            frame=frame.index,
            timestamp_s=frame.timestamp_s,
            name=frame.name,
            track_ids=ids[order],
            pixels=pixels[order],
            bearings=bearings[order],
            colors=_colors_at(frame.image, pixels[order]),
        )
        self._last_gray = gray
        self.history.put(self._last)
        return self._last

    def _link(self, index: int, gray: Image) -> tuple[Ints, Floats, bool]:
        """Tracks of the last frame found in this one: ids, pixels, and whether descriptors did it."""
        if self._last is None or self._last_gray is None:
            return np.zeros(0, np.int64), np.zeros((0, 2)), False
        kept, moved = self._flow(self._last_gray, gray, self._last.pixels)
        if kept.sum() >= self._config.flow_survival * len(self._last) and kept.any():
            return self._last.track_ids[kept], moved[kept], False
        sift = self._detect_sift(index, gray)
        if not self._sift_frames or self._sift_frames[-1].frame != self._last.frame:
            # The frames before were linked by flow, or not at all: start from the last one.
            self._sift_frames.clear()
            self._sift_frames.append(self._detect_sift(self._last.frame, self._last_gray))
        matches = [
            (old, *match_descriptors(old.descriptors, sift.descriptors, self._config.sift_ratio))
            for old in self._sift_frames
        ]
        if len(matches[-1][1]) <= kept.sum():
            return self._last.track_ids[kept], moved[kept], False
        for old, i_old, i_new in reversed(matches):
            self._join(old, sift, i_old, i_new)
        self._sift_frames.append(sift)
        linked = sift.track_ids >= 0
        return sift.track_ids[linked], sift.pixels[linked], True

    def _flow(self, before: Image, after: Image, pixels: Floats) -> tuple[Bools, Floats]:
        """Lucas-Kanade forward and back: which points survive (N,), and where all of them went (N, 2)."""
        import cv2

        if len(pixels) == 0:
            return np.zeros(0, bool), np.zeros((0, 2))
        start = pixels.astype(np.float32)
        window = (self._config.window_px, self._config.window_px)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
        levels = self._config.pyramid_levels
        end, found, _ = cv2.calcOpticalFlowPyrLK(
            before, after, start, np.empty_like(start), winSize=window, maxLevel=levels, criteria=criteria
        )
        # The way back starts where it should end, so it needs no coarse levels.
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(
            after, before, end, start.copy(), winSize=window, maxLevel=1, criteria=criteria,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )  # fmt: skip
        height, width = after.shape
        closed = np.linalg.norm(back - start, axis=1) < self._config.forward_backward_px
        inside = (end >= 0).all(axis=1) & (end[:, 0] <= width - 1) & (end[:, 1] <= height - 1)
        kept = (found.ravel() > 0) & (found_back.ravel() > 0) & closed & inside
        moved = end.astype(float)
        # Two tracks that slid onto one another are one: the older stays.
        survivors = np.flatnonzero(kept)
        kept[:] = False
        kept[survivors[first_per_cell(moved[survivors], 0.5 * self._config.min_distance * width)]] = True
        return kept, moved

    def _detect(self, gray: Image, occupied: Floats, count: int) -> Floats:
        """Up to ``count`` corners (n, 2) away from the occupied places."""
        import cv2

        distance = self._config.min_distance * gray.shape[1]
        mask = np.full(gray.shape, 255, np.uint8)
        for x, y in np.round(occupied).astype(int):
            cv2.circle(mask, (int(x), int(y)), round(distance), 0, -1)
        # A corner of 0.2 % of the strongest one's response still is a corner: a checkerboard in view must not take the
        # features from the table that it lies on.
        corners = cv2.goodFeaturesToTrack(gray, count, 0.002, distance, mask=mask, blockSize=5)
        return np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(float)

    def _detect_sift(self, index: int, gray: Image) -> _SiftFrame:
        found = detect_sift(gray, self._config.sift_features)
        return _SiftFrame(index, found.pixels, found.descriptors, np.full(len(found.pixels), -1, np.int64))

    def _join(self, old: _SiftFrame, new: _SiftFrame, i_old: Ints, i_new: Ints) -> None:
        """Put matched keypoints into one track, and enrich the old frame in the history by what it did not know."""
        a, b = old.track_ids[i_old], new.track_ids[i_new]
        fresh = (a < 0) & (b < 0)
        ids = self._new_ids(int(fresh.sum()))
        old.track_ids[i_old[fresh]] = ids
        new.track_ids[i_new[fresh]] = ids
        # A track that is longer in one of the two frames continues in the other, unless it is there already.
        to_new = (a >= 0) & (b < 0) & ~np.isin(a, new.track_ids)
        new.track_ids[i_new[to_new]] = a[to_new]
        to_old = (a < 0) & (b >= 0) & ~np.isin(b, old.track_ids)
        old.track_ids[i_old[to_old]] = b[to_old]
        added = i_old[fresh | to_old]
        if len(added):
            self._enrich(old.frame, old.track_ids[added], old.pixels[added])

    def _enrich(self, frame: int, ids: Ints, pixels: Floats) -> None:
        known = self.history[frame]
        bearings = self._camera.bearings(pixels)
        seen = np.isfinite(bearings).all(axis=1)
        ids, pixels, bearings = ids[seen], pixels[seen], bearings[seen]
        all_ids = np.concatenate([known.track_ids, ids])
        order = np.argsort(all_ids)
        colors = np.concatenate([known.colors, np.full((len(ids), 3), 128, np.uint8)])
        enriched = replace(
            known,
            track_ids=all_ids[order],
            pixels=np.concatenate([known.pixels, pixels])[order],
            bearings=np.concatenate([known.bearings, bearings])[order],
            colors=colors[order],
        )
        self.history.put(enriched)
        self.revised = (*self.revised, enriched)

    def _new_ids(self, count: int) -> Ints:
        ids = np.arange(self._next_id, self._next_id + count, dtype=np.int64)
        self._next_id += count
        return ids


def _colors_at(image: Image, pixels: Floats) -> Image:
    """RGB (N, 3) of the pixels nearest to the points."""
    if len(pixels) == 0:
        return np.zeros((0, 3), np.uint8)
    column, row = np.round(pixels).astype(int).T
    values = image[np.clip(row, 0, image.shape[0] - 1), np.clip(column, 0, image.shape[1] - 1)]
    return np.repeat(values[:, None], 3, axis=1) if values.ndim == 1 else np.ascontiguousarray(values[:, ::-1])
