"""Keeps what a picture of a run shows beside its result: a few frames with their tracks, and the last pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from slam_init.recording.images import RecentImages
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Bools, Floats, Image, Ints, evenly_spaced
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt

#: Largest number of frames in memory besides the recent images. Where there are more, every second one is dropped, so
#: that those that are left are evenly spaced over a run of any length.
_MOST_FRAMES = 16


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """A frame with its tracks."""

    #: Absolute index of the frame.
    index: int
    #: (h, w) A small copy of the image.
    image: Image
    #: (N,) Strictly increasing.
    track_ids: Ints
    #: (N, 2) Positions of the tracks in the image as it was read.
    pixels: Floats


@dataclass(frozen=True, eq=False)
class MatchedImages:
    """Two images and their matches."""

    #: (int, int) Absolute indices.
    frames: tuple[int, int]
    #: (h, w) Small copies of the images.
    images: tuple[Image, Image]
    #: pixels1, pixels2: (N, 2) The matches, in pixels of the images as they were read.
    pixels1: Floats
    pixels2: Floats
    #: inliers, moving: (N,) Which matches the best motion explains, and which ones lie on bodies with a motion of
    #: their own.
    inliers: Bools
    moving: Bools
    #: Whether a motion was estimated from the matches. Where none was, all matches are neither inliers nor outliers.
    judged: bool


@dataclass(frozen=True, eq=False)
class Story:
    """What a picture shows beside the result."""

    #: In time order: keyframes of an accepted map, else frames that are evenly spaced over the run.
    frames: tuple[ShownFrame, ...] = ()
    #: The last pair that was tried; where no pair was estimated, the first and the last frame with their common
    #: tracks. None without two frames.
    pair: MatchedImages | None = None


@dataclass(eq=False)
class _Spaced:
    """At most :data:`_MOST_FRAMES` frames, evenly spaced over all that were added."""

    frames: list[ShownFrame] = field(default_factory=list)
    step: int = 1
    seen: int = 0

    def add(self, shown: ShownFrame) -> None:
        if self.seen % self.step == 0:
            if len(self.frames) == _MOST_FRAMES:
                self.frames = self.frames[::2]
                self.step *= 2
            if self.seen % self.step == 0:
                self.frames.append(shown)
        self.seen += 1


class StoryRecorder(Recorder):
    """Keeps the story of a run, in bounded memory.

    * ``images``: Small copies of the last images, where another recorder keeps them too.
    """

    def __init__(self, images: RecentImages | None = None) -> None:
        self._images = images or RecentImages()
        self._spaced = _Spaced()
        self._last: ShownFrame | None = None
        self._pair: MatchedImages | None = None
        self._keyframes: tuple[ShownFrame, ...] = ()
        self._ended = False

    def restarted(self) -> None:
        """End the story with its map: what follows belongs to another one."""
        self._ended = bool(self._keyframes)

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Keep the frame, if it is one of those that are evenly spaced."""
        if self._keyframes:  # the story ends with the map
            return
        self._images.add(frame)
        shown = self._shown(observations)
        if shown is not None:
            self._last = shown
            self._spaced.add(shown)

    def attempt(self, attempt: Attempt) -> None:
        """Keep the pair of an attempt that has matches."""
        if self._ended:
            return
        if not len(attempt.pixels1) or len(attempt.frames) < 2:
            return
        first, second = (self._images.get(index) for index in attempt.frames[:2])
        if first is None or second is None:
            return
        moving = attempt.moving if attempt.moving.size else np.zeros(len(attempt.pixels1), bool)
        self._pair = MatchedImages(
            (attempt.frames[0], attempt.frames[1]),
            (first, second),
            attempt.pixels1,
            attempt.pixels2,
            attempt.inliers,
            moving & ~attempt.inliers,
            attempt.judged,
        )

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Keep the keyframes of the accepted map."""
        if self._keyframes:  # those of the first map, which the picture shows
            return
        chosen = [observations[k] for k in evenly_spaced(len(observations), _MOST_FRAMES)]
        self._keyframes = tuple(shown for seen in chosen if (shown := self._shown(seen)) is not None)

    def story(self) -> Story:
        """Return what was kept."""
        frames = self._keyframes or tuple(self._spaced.frames)
        if not self._keyframes and self._last is not None and frames[-1].index != self._last.index:
            frames = (*frames, self._last)
        return Story(frames, self._pair or _first_and_last(frames))

    def _shown(self, observations: Observations) -> ShownFrame | None:
        image = self._images.get(observations.frame)
        if image is None:
            return None
        return ShownFrame(observations.frame, image, observations.track_ids, observations.pixels)


def _first_and_last(frames: Sequence[ShownFrame]) -> MatchedImages | None:
    """The first and the last frame with the tracks that both see."""
    if len(frames) < 2:
        return None
    first, last = frames[0], frames[-1]
    _, i, j = np.intersect1d(first.track_ids, last.track_ids, return_indices=True)
    none = np.zeros(len(i), bool)
    return MatchedImages(
        (first.index, last.index), (first.image, last.image), first.pixels[i], last.pixels[j], none, none, judged=False
    )
