"""Features and tracks: the image points of different frames that show the same point of the world.

In video, points are followed from frame to frame (:mod:`~slam_init.frontend.flow`): by the patches around them
where they began, and by Lucas-Kanade flow with a forward-backward check. If the flow loses more than half of
the tracks in one step (photographs, a cut, a fast pan), SIFT descriptors link the frame to the last few frames, if they
link more points than the flow, or as many and contradict it. The tracks that the flow kept go on beside the new ones
where the descriptors confirm the flow (:func:`confirmed_by`): a map whose landmarks they show is not lost at such a
frame. Both give the same kind of tracks: the modules that use the tracks do not know their origin.

Where a frame has a mask, no track begins in an ignored pixel, and tracks that come near one end
(:mod:`slam_init.frontend.masking`). What the ignored pixels show changes nothing.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.frontend.flow import Flow, flow, follow
from slam_init.frontend.masking import Trackable
from slam_init.frontend.patch_size import SIDE_PX
from slam_init.frontend.patches import Patches, Sought, smoothed
from slam_init.frontend.sift import detect_sift, first_per_cell, match_descriptors
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations, as_image
from slam_init.types.history import History, common_tracks

#: The flow of a track agrees with descriptors where it lies among those of so many neighbours, which span the depths
#: around the track. The flow of a frame is trusted where two thirds of its tracks agree: in 4 links of a driving car 86
#: to 93 %, of which 98 % are right by the true motion; in 6 links of photographs whose flow is wrong 16 to 59 %.
_NEIGHBOURS, _LEAST_CONFIRMED = 4, 2 / 3
#: Two numbers of links that differ by less than this many deviations of the larger one are alike: then a flow that the
#: descriptors contradict gives way. Fewer matches contradict nothing: where lamps flicker, four tenths of a right flow
#: agree with the few matches there are.
_CHANCE = 2.0
#: The exposure is the median over this number of frames with trails: the share of gradients along the motion depends on
#: what the camera sees.
_TRAIL_FRAMES = 15


@dataclass(eq=False)
class Keypoints:
    """Keypoints of one frame with track ids (-1: no track yet). The ids are updated in place."""

    frame: int
    pixels: Floats
    track_ids: Ints


@dataclass(eq=False)
class _SiftFrame(Keypoints):
    """The same with descriptors."""

    descriptors: Floats


class _Last(NamedTuple):
    """The last frame."""

    seen: Observations
    gray: Image
    trackable: Trackable | None
    #: (N, 2) By how much each track had moved since the frame before; NaN where it was not in that.
    moved: Floats


class _Linked(NamedTuple):
    """Tracks that are found in a frame."""

    ids: Ints
    pixels: Floats
    #: Covariances of the drift since they began, px^2: of the first tracks. Descriptors found the others without one.
    drifts: Floats
    #: Standard deviation of the step of a typical track; 0 where descriptors found the tracks.
    step_px: float
    by_descriptors: bool


class Tracker:
    """Follows features from frame to frame and keeps their history.

    * ``camera``: The lens that the history starts with.
    * ``history_limit``: Number of recent frames in the history.
    * ``revised``: Earlier frames that got additional tracks in the last call of :meth:`track`.
    """

    def __init__(self, camera: Camera, config: TrackingConfig, history_limit: int = 150) -> None:
        self.history = History(camera, history_limit)
        self.revised: tuple[Observations, ...] = ()
        self._config = config
        self._last: _Last | None = None
        self._trackable: Trackable | None = None
        self._sift_frames: deque[_SiftFrame] = deque(maxlen=config.sift_frames)
        self._patches = Patches()
        self._exposures_s: deque[float] = deque(maxlen=_TRAIL_FRAMES)
        self._next_id = 0

    def track(self, frame: Frame) -> Observations:
        """Follow the tracks into the next frame, and start new tracks if too many were lost.

        If the frame is linked by descriptors, new tracks may be found in earlier frames as well. They are added to the
        history.
        """
        self._check_size(frame)
        self._trackable = self._trackable_of(frame)
        gray = frame.gray if self._trackable is None else self._trackable.blanked(frame.gray)
        smooth = smoothed(gray)
        self.revised = ()
        ids, pixels, drifts, step_px, by_descriptors = self._link(frame, gray, smooth)
        wanted = self._config.max_tracks
        if not by_descriptors and len(ids) < (1 - self._config.refill_share) * wanted:
            new = self._detect(gray, pixels, wanted - len(ids))
            ids = np.concatenate([ids, self._new_ids(len(new))])
            pixels = np.concatenate([pixels, new])
        seen = self._seen(frame, ids, pixels, drifts)
        self._patches.follow(smooth, seen.track_ids, seen.pixels, seen.drifts)
        exposure_s = float(np.median(self._exposures_s)) if self._exposures_s else 0.0
        seen = replace(seen, step_px=step_px, exposure_s=exposure_s)
        moved = np.full((len(seen), 2), np.nan)
        if self._last is not None:
            now, then = common_tracks(seen, self._last.seen)
            moved[now] = seen.pixels[now] - self._last.seen.pixels[then]
        self._last = _Last(seen, gray, self._trackable, moved)
        self.history.put(seen)
        return seen

    def _seen(self, frame: Frame, ids: Ints, pixels: Floats, drifts: Floats) -> Observations:
        """The tracks of a frame without pixels beyond the field of view, which have no ray.

        * ``drifts``: Those of the first tracks, as of :class:`_Linked`; 0 for the others.
        """
        none = (np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3)))
        empty = Observations(frame.index, frame.timestamp_s, frame.name, *none)
        return self._with(empty, ids, pixels, colors_at(frame.image, pixels), drifts)

    def _with(self, known: Observations, ids: Ints, pixels: Floats, colors: Image, drifts: Floats) -> Observations:
        """A frame with more tracks; see :meth:`_seen`."""
        ids, pixels = np.concatenate([known.track_ids, ids]), np.concatenate([known.pixels, pixels])
        more = np.zeros((len(ids) - len(known.drifts) - len(drifts), 2, 2))
        bearings, order = self.history.camera.bearings(pixels), np.argsort(ids)
        order = order[np.isfinite(bearings[order]).all(axis=1)]
        return replace(
            known,
            track_ids=ids[order],
            pixels=pixels[order],
            bearings=bearings[order],
            colors=np.concatenate([known.colors, colors])[order],
            drifts=np.concatenate([known.drifts, drifts, more])[order],
            readout_s=0.0,
        )

    def _check_size(self, frame: Frame) -> None:
        """Refuse an image of another size than that of the camera, before anything changes."""
        camera = self.history.camera
        as_image(frame.image, f"the image of frame {frame.index}", (camera.width, camera.height))

    def _trackable_of(self, frame: Frame) -> Trackable | None:
        if frame.mask is None:
            return None
        if self._trackable is not None and np.array_equal(self._trackable.mask, frame.mask):  # one mask for all frames
            return self._trackable
        return Trackable(frame.mask, max(self._config.window_px, SIDE_PX))

    def _link(self, frame: Frame, gray: Image, smooth: Image) -> _Linked:
        """The tracks of the last frame that are found in this one."""
        last = self._last
        if last is None:
            return _Linked(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), 0.0, False)
        found, sought = follow(last.gray, gray, smooth, last.seen, last.moved, self._patches, self._config)
        self._clear(found)
        interval_s = frame.timestamp_s - last.seen.timestamp_s
        if found.trail is not None and interval_s > 0:
            self._exposures_s.append(found.trail * interval_s)
        if found.kept.sum() >= self._config.flow_survival * len(last.seen) and found.kept.any():
            return self._aligned(last, smooth, found, sought)
        return self._link_by_descriptors(last, frame.index, gray, smooth, found, sought)

    def _link_by_descriptors(
        self, last: _Last, index: int, gray: Image, smooth: Image, found: Flow, sought: Sought | None
    ) -> _Linked:
        """Link a frame in which the flow has lost most tracks: by descriptors, or by the flow where they link fewer."""
        kept, seen = found.kept, last.seen
        sift = self._detect_sift(index, gray, self._trackable)
        if not self._sift_frames or self._sift_frames[-1].frame != seen.frame:
            # The last frame was linked by flow, or not at all. Its keypoints are the first to match with.
            self._sift_frames.clear()
            self._sift_frames.append(self._detect_sift(seen.frame, last.gray, last.trackable))
        matches = [
            (old, *match_descriptors(old.descriptors, sift.descriptors, self._config.sift_ratio))
            for old in self._sift_frames
        ]
        newest, i_last, i_now = matches[-1]
        matched, tolerance_px = (newest.pixels[i_last], sift.pixels[i_now]), self._config.forward_backward_px
        confirmed = confirmed_by(*matched, seen.pixels[kept], found.pixels[kept], tolerance_px)
        more = int(kept.sum()) - len(i_last)
        if more >= 0 and (more > _CHANCE * np.sqrt(kept.sum()) or confirmed.any() or not kept.any()):
            # The next frame may have lost the flow as well: it matches with these keypoints then.
            self._sift_frames.clear()
            self._sift_frames.append(sift)
            return self._aligned(last, smooth, found, sought)
        for old, i_old, i_new in reversed(matches):
            self._join(old, sift, i_old, i_new)
        self._sift_frames.append(sift)
        kept[kept] = confirmed
        # The flow may have lost the other points only since it did not know where to look. They are sought once more
        # where the matches around them went.
        lost = np.flatnonzero(~kept)
        expected = expected_by(*matched, seen.pixels[lost])
        if len(expected):
            guided = flow(last.gray, gray, seen.pixels[lost], self._config, expected)
            self._clear(guided)
            again = guided.kept
            again[again] = confirmed_by(*matched, seen.pixels[lost[again]], guided.pixels[again], tolerance_px)
            found.put(lost, guided)
        kept[np.isin(seen.track_ids, sift.track_ids)] = False
        by_flow = self._aligned(last, smooth, found, None)
        # Of two tracks that meet in one place only that of the flow is kept, as it is the older one.
        linked = np.flatnonzero(sift.track_ids >= 0)
        squares = np.sum((sift.pixels[linked][:, None] - by_flow.pixels[None]) ** 2, axis=2)
        linked = linked[squares.min(axis=1, initial=np.inf) > (0.5 * self._config.min_distance * gray.shape[1]) ** 2]
        ids = np.concatenate([by_flow.ids, sift.track_ids[linked]])
        return _Linked(ids, np.concatenate([by_flow.pixels, sift.pixels[linked]]), by_flow.drifts, 0.0, True)

    def _clear(self, found: Flow) -> None:
        """End the tracks that come near ignored pixels."""
        if self._trackable is not None:
            found.kept[~self._trackable.patches_are_clear(found.pixels)] = False

    def _aligned(self, last: _Last, smooth: Image, found: Flow, sought: Sought | None) -> _Linked:
        """The tracks of the last frame that are found, brought back to their points."""
        kept = found.kept
        ids = last.seen.track_ids[kept]
        sought = None if sought is None else Sought(*(one[kept] for one in sought))
        aligned = self._patches.align(smooth, ids, found.pixels[kept], found.remainders[kept], sought)
        drifts = found.covariances[kept] + last.seen.drifts[kept]
        drifts[aligned.succeeded] = aligned.drifts[aligned.succeeded]
        # Tracks that flow has left apart may come back to one place.
        single = first_per_cell(aligned.pixels, 0.5 * self._config.min_distance * smooth.shape[1])
        return _Linked(ids[single], aligned.pixels[single], drifts[single], found.step_px, False)

    def _detect(self, gray: Image, occupied: Floats, count: int) -> Floats:
        """Up to ``count`` corners (n, 2) at a distance from the occupied pixels."""
        import cv2

        distance = self._config.min_distance * gray.shape[1]
        mask = np.full(gray.shape, 255, np.uint8) if self._trackable is None else self._trackable.detectable()
        for x, y in np.round(occupied).astype(int).tolist():
            cv2.circle(mask, (x, y), round(distance), 0, -1)
        # The threshold is 0.2 % of the response of the strongest corner. With a higher one, a checkerboard in view
        # would suppress the weaker features of the table on which it lies.
        corners = cv2.goodFeaturesToTrack(gray, count, 0.002, distance, mask=mask, blockSize=5)
        if corners is None:
            return np.zeros((0, 2))
        return corners.reshape(-1, 2).astype(float)

    def _detect_sift(self, index: int, gray: Image, trackable: Trackable | None) -> _SiftFrame:
        found = detect_sift(gray, self._config.sift_features, trackable)
        return _SiftFrame(index, found.pixels, np.full(len(found.pixels), -1, np.int64), found.descriptors)

    def _join(self, old: Keypoints, new: Keypoints, i_old: Ints, i_new: Ints) -> None:
        """Put matched keypoints into one track, and add the new tracks of the old frame to the history."""
        a, b = old.track_ids[i_old], new.track_ids[i_new]
        fresh = (a < 0) & (b < 0)
        ids = self._new_ids(int(fresh.sum()))
        old.track_ids[i_old[fresh]] = ids
        new.track_ids[i_new[fresh]] = ids
        # A track of one frame continues in the other, unless that frame has the track already.
        to_new = (a >= 0) & (b < 0) & ~np.isin(a, new.track_ids)
        new.track_ids[i_new[to_new]] = a[to_new]
        to_old = (a < 0) & (b >= 0) & ~np.isin(b, old.track_ids)
        old.track_ids[i_old[to_old]] = b[to_old]
        added = i_old[fresh | to_old]
        if len(added):
            self._add_to_history(old.frame, old.track_ids[added], old.pixels[added])

    def _add_to_history(self, frame: int, ids: Ints, pixels: Floats) -> None:
        known = self.history[frame]
        added = np.flatnonzero(~np.isin(ids, known.track_ids))  # the flow may have continued a track into this frame
        grey = np.full((len(added), 3), 128, np.uint8)
        enriched = self._with(known, ids[added], pixels[added], grey, np.zeros((0, 2, 2)))
        self.history.put(enriched)
        self.revised = (*self.revised, enriched)

    def _new_ids(self, count: int) -> Ints:
        ids = np.arange(self._next_id, self._next_id + count, dtype=np.int64)
        self._next_id += count
        return ids


def confirmed_by(old: Floats, new: Floats, before: Floats, after: Floats, tolerance_px: float) -> Bools:
    """Which points the flow has moved as matches around them moved; none where it is not to be trusted.

    Shapes: ``old, new`` (M, 2), ``before, after`` (N, 2), returns (N,).

    * ``old, new``: Matches by descriptors.
    * ``before, after``: Points, and where the flow put them.
    """
    if len(old) < _NEIGHBOURS or not len(before):
        return np.zeros(len(before), bool)
    around = _moves_around(old, new, before)
    low, high = around.min(axis=1) - tolerance_px, around.max(axis=1) + tolerance_px
    moved = after - before
    agrees = ((low <= moved) & (moved <= high)).all(axis=1)
    return np.asarray(agrees & (agrees.mean() >= _LEAST_CONFIRMED))


def expected_by(old: Floats, new: Floats, points: Floats) -> Floats:
    """Where points are expected by the matches around them: moved as the median of these.

    Shapes: ``old, new`` (M, 2), ``points`` (N, 2), returns (N, 2).

    * Returns: Empty where there are too few matches.
    """
    if len(old) < _NEIGHBOURS or not len(points):
        return np.zeros((0, 2))
    return np.asarray(points + np.median(_moves_around(old, new, points), axis=1))


def _moves_around(old: Floats, new: Floats, points: Floats) -> Floats:
    """How far the matches next to each point have moved, (N, 4, 2)."""
    squares = np.sum((points[:, None] - old[None]) ** 2, axis=2)
    return np.asarray((new - old)[np.argpartition(squares, _NEIGHBOURS - 1, axis=1)[:, :_NEIGHBOURS]])


def colors_at(image: Image, pixels: Floats) -> Image:
    """Give the RGB values (N, 3) of the pixels nearest to points.

    Shapes: ``image`` (H, W) or (H, W, 3), ``pixels`` (N, 2), returns (N, 3).
    """
    if len(pixels) == 0:
        return np.zeros((0, 3), np.uint8)
    column, row = np.round(pixels).astype(int).T
    values = image[np.clip(row, 0, image.shape[0] - 1), np.clip(column, 0, image.shape[1] - 1)]
    return np.repeat(values[:, None], 3, axis=1) if values.ndim == 1 else np.ascontiguousarray(values[:, ::-1])
