"""The story of a run in small images: its last frames with their tracks, the last pair, the keyframes of its map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slam_init.recording.images import PAIR_SIDE_PX, reduced
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Floats, Image, Ints
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt

#: Number of frames in memory. The reference of a pair may be as old as the oldest candidate keyframe.
_MEMORY_FRAMES = 400


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


#: Small copies (h, w) of two images, and the attempt with their matches, in pixels of the images as they were read.
ShownPair = tuple[Image, Image, Attempt]


class StoryRecorder(Recorder):
    """Keeps the story of a run, in bounded memory.

    * ``recent``: The last frames, by their indices.
    * ``pair``: The last pair that was tried before the first map; None where no pair had matches.
    """

    def __init__(self) -> None:
        self.recent: dict[int, ShownFrame] = {}
        self.pair: ShownPair | None = None
        self._keyframes: tuple[ShownFrame, ...] = ()

    @property
    def frames(self) -> tuple[ShownFrame, ...]:
        """The keyframes of the first map, else the last frames."""
        return self._keyframes or tuple(self.recent.values())

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Keep the frame."""
        image = reduced(frame.image, PAIR_SIDE_PX)
        self.recent[frame.index] = ShownFrame(frame.index, image, observations.track_ids, observations.pixels)
        if len(self.recent) > _MEMORY_FRAMES:
            del self.recent[next(iter(self.recent))]

    def attempt(self, attempt: Attempt) -> None:
        """Keep the pair of an attempt that has matches."""
        images = [self.recent[index].image for index in attempt.frames[:2] if index in self.recent]
        if not self._keyframes and len(attempt.pixels1) and len(images) == 2:
            self.pair = (images[0], images[1], attempt)

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Keep the keyframes of the first map."""
        shown = tuple(self.recent[one.frame] for one in map_.keyframes if one.frame in self.recent)
        self._keyframes = self._keyframes or shown
