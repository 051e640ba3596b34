"""Tracks from a matcher of two images, in the place of the optical flow.

A new image is matched with the last one, and with those 2, 4 and 8 frames before it: a detector finds two thirds of its
points again, so that a track of single steps would end after two or three frames. Matched points in the same half pixel
of one image are one keypoint. Matches join keypoints to tracks; a match that would join two keypoints of one image is
left out, as for the descriptors of :mod:`slam_init.frontend.tracks`. Where a track is found to begin earlier, the
earlier frame gets it too (:attr:`slam_init.frontend.tracks.Tracker.revised`).
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.errors import ConfigError, SlamInitError
from slam_init.frontend.masking import Trackable
from slam_init.frontend.matchers import Matcher, make_matcher
from slam_init.frontend.tracks import Keypoints, Tracker
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations

#: How many frames before the new one the images are that it is matched with.
FRAMES_BACK = (1, 2, 4, 8)
#: Points in the same cell of this side, in pixels, are one keypoint. A detector gives the same numbers in each match.
_CELL_PX = 0.5
#: Least distance of a match from an ignored pixel, in pixels: the reach of a corner.
_CLEAR_PX = 2.0


class _Matched(Keypoints):
    """The matched points of one frame, which become more with each match."""

    def __init__(self, frame: Frame, trackable: Trackable | None) -> None:
        super().__init__(frame.index, np.zeros((0, 2)), np.zeros(0, np.int64))
        # A caller may read the next image into the same array.
        self.image, self.name, self._trackable = frame.image.copy(), frame.name, trackable
        self._positions: dict[tuple[int, ...], int] = {}

    def are_clear(self, points: Floats) -> Bools:
        """Which points (N, 2) lie in the image, and in no ignored pixel; NaN does not."""
        size = np.array(self.image.shape[1::-1])
        clear: Bools = np.asarray(((points >= -0.5) & (points < size - 0.5)).all(axis=1))
        if self._trackable is not None:
            clear[clear] = self._trackable.are_clear(points[clear], np.full(clear.sum(), _CLEAR_PX))
        return clear

    def at(self, points: Floats) -> Ints:
        """Give the positions (N,) of the keypoints at points (N, 2); new ones are added."""
        cells = map(tuple, np.round(points / _CELL_PX).astype(int).tolist())
        known = len(self.pixels)
        found = np.array([self._positions.setdefault(cell, len(self._positions)) for cell in cells], np.int64)
        added, first = np.unique(found, return_index=True)
        self.pixels = np.concatenate([self.pixels, points[first[added >= known]]])
        self.track_ids = np.concatenate([self.track_ids, np.full(len(self.pixels) - known, -1, np.int64)])
        return found


class MatchTracker(Tracker):
    """Gives tracks as a :class:`~slam_init.frontend.tracks.Tracker` does, by a matcher.

    * ``matcher``: Matches two images.
    """

    def __init__(self, camera: Camera, config: TrackingConfig, matcher: Matcher) -> None:
        super().__init__(camera, config)
        self._matcher = matcher
        self._recent: deque[_Matched] = deque(maxlen=max(FRAMES_BACK))

    def track(self, frame: Frame) -> Observations:
        """Match the frame with earlier ones, and give its tracks."""
        self._check_size(frame)
        self._trackable, self.revised = self._trackable_of(frame), ()
        new = _Matched(frame, self._trackable)
        # The history has to hold a frame before tracks are added to it.
        recent = [
            self._recent[-n] for n in FRAMES_BACK if n <= len(self._recent) and self._recent[-n].frame in self.history
        ]
        # A matcher that fails has changed nothing.
        matches = [self._matches(old, new) for old in recent]
        for old, (points_old, points_new) in zip(recent, matches, strict=True):
            self._join(old, new, old.at(points_old), new.at(points_new))
        tracked = np.flatnonzero(new.track_ids >= 0)
        # Each image is measured again, so that no track drifts.
        observed = self._seen(frame, new.track_ids[tracked], new.pixels[tracked], np.zeros((0, 2, 2)))
        self.history.put(observed)
        self._recent.append(new)
        return observed

    def _matches(self, old: _Matched, new: _Matched) -> tuple[Floats, Floats]:
        """Matched points (N, 2) of two frames: each point once, the best match of a point, none in ignored pixels."""
        points_old, points_new, scores = self._asked(old, new)
        kept = np.flatnonzero(old.are_clear(points_old) & new.are_clear(points_new) & np.isfinite(scores))
        kept = kept[np.argsort(-scores[kept], kind="stable")]
        for points in (points_old, points_new):
            _, first = np.unique(np.round(points[kept] / _CELL_PX), axis=0, return_index=True)
            kept = kept[np.sort(first)]
        return points_old[kept], points_new[kept]

    def _asked(self, old: _Matched, new: _Matched) -> tuple[Floats, Floats, Floats]:
        """Call the matcher, which may be code of the user."""
        name = f"the matcher ({old.name}, {new.name})"
        try:
            found: Any = self._matcher(old.image, new.image)
        except SlamInitError:
            raise
        except (Exception, SystemExit) as error:
            raise SlamInitError(f"{name} failed: {type(error).__name__}: {error}") from error
        form = "give points (N, 2), (N, 2), scores (N,)"
        try:
            points_old, points_new, scores = (np.asarray(one, float) for one in found)
        except (TypeError, ValueError) as error:
            raise SlamInitError(f"{name} returned {type(found).__name__} ({error}): {form}") from error
        shapes, count = (points_old.shape, points_new.shape, scores.shape), len(scores) if scores.ndim else 0
        if shapes != ((count, 2), (count, 2), (count,)):
            raise SlamInitError(f"{name} returned arrays of shapes {shapes}: {form}")
        return points_old, points_new, scores


def make_tracker(camera: Camera, config: TrackingConfig, matcher: Matcher | None = None) -> Tracker:
    """Make what follows the points: by a matcher, by that of the configuration, or by the flow."""
    if matcher is None and config.matcher:
        matcher = make_matcher(config.matcher)
    if matcher is not None and not callable(matcher):
        raise ConfigError(f"matcher is {matcher!r:.60}: give a callable of two images; names are for tracking.matcher")
    return Tracker(camera, config) if matcher is None else MatchTracker(camera, config, matcher)
