"""Keeps what a picture of a run shows beside its result: a few frames with their tracks, and the last pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.recording.images import RecentImages
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Floats, Image, Ints, evenly_spaced
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import Verdict
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
class ShownPair:
    """Two images and their matches."""

    #: (h, w) Small copies of the images.
    images: tuple[Image, Image]
    #: With the matches, in pixels of the images as they were read.
    attempt: Attempt


@dataclass(frozen=True, eq=False)
class Story:
    """What a picture shows beside the result."""

    #: In time order: keyframes of an accepted map, else frames that are evenly spaced over the run.
    frames: tuple[ShownFrame, ...] = ()
    #: The last pair that was tried; where no pair was estimated, the first and the last frame with their common
    #: tracks. None without two frames.
    pair: ShownPair | None = None


class StoryRecorder(Recorder):
    """Keeps the story of a run, in bounded memory.

    * ``images``: Small copies of the last images, where another recorder keeps them too.
    """

    def __init__(self, images: RecentImages | None = None) -> None:
        self._images = images or RecentImages()
        #: Every so many of the frames that were seen.
        self._spaced: list[ShownFrame] = []
        self._step, self._seen = 1, 0
        self._last: ShownFrame | None = None
        self._pair: ShownPair | None = None
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
        self._last = shown = self._shown(observations)
        if shown is not None and self._seen % self._step == 0:
            if len(self._spaced) == _MOST_FRAMES:
                self._spaced, self._step = self._spaced[::2], 2 * self._step
            self._spaced.append(shown)
        self._seen += 1

    def attempt(self, attempt: Attempt) -> None:
        """Keep the pair of an attempt that has matches."""
        if self._ended or not len(attempt.pixels1) or len(attempt.frames) < 2:
            return
        first, second = (self._images.get(index) for index in attempt.frames[:2])
        if first is not None and second is not None:
            self._pair = ShownPair((first, second), attempt)

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Keep the keyframes of the accepted map."""
        if self._keyframes:  # those of the first map, which the picture shows
            return
        chosen = [observations[k] for k in evenly_spaced(len(observations), _MOST_FRAMES)]
        self._keyframes = tuple(shown for seen in chosen if (shown := self._shown(seen)) is not None)

    def story(self) -> Story:
        """Return what was kept."""
        frames = self._keyframes or tuple(self._spaced)
        if not self._keyframes and self._last is not None and frames[-1].index != self._last.index:
            frames = (*frames, self._last)
        return Story(frames, self._pair or _first_and_last(frames))

    def _shown(self, observations: Observations) -> ShownFrame | None:
        image = self._images.get(observations.frame)
        if image is None:
            return None
        return ShownFrame(observations.frame, image, observations.track_ids, observations.pixels)


def _first_and_last(frames: Sequence[ShownFrame]) -> ShownPair | None:
    """The first and the last frame with the tracks that both see, as an attempt without evidence."""
    if len(frames) < 2:
        return None
    first, last = frames[0], frames[-1]
    _, i, j = np.intersect1d(first.track_ids, last.track_ids, return_indices=True)
    indices, none = (first.index, last.index), np.zeros(len(i), bool)
    tracks = Attempt(
        indices, Verdict.TOO_FEW_MATCHES, pixels1=first.pixels[i], pixels2=last.pixels[j], inliers=none, moving=none
    )
    return ShownPair((first.image, last.image), tracks)
