"""The story of a run in small images: its last frames with their tracks, the last pair, the keyframes of its map.

Images are reduced here, for the recording too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt

#: Images are reduced to this many pixels on their longer side, and the images of a pair to half of it. This is enough
#: to check a match by eye, and 300 frames with their tracks take less than 30 MB.
LONG_SIDE_PX, PAIR_SIDE_PX = 640, 320


def reduced_shape(height: int, width: int, long_side_px: int) -> tuple[int, int]:
    """Compute the shape of a reduced image."""
    factor = min(1.0, long_side_px / max(height, width))
    return max(1, round(height * factor)), max(1, round(width * factor))


def reduced(image: Image, long_side_px: int) -> Image:
    """Reduce an image to a largest length of its longer side: ``image`` (H, W), returns (h, w)."""
    import cv2

    height, width = reduced_shape(image.shape[0], image.shape[1], long_side_px)
    if (height, width) == image.shape[:2]:
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def bgr(image: Image) -> Image:
    """Return an image with three channels: ``image`` (H, W), returns (H, W, 3)."""
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


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


def moving_matches(attempt: Attempt) -> Bools:
    """Which matches (N,) of a pair lie on moving objects, and are no inliers of the camera."""
    return attempt.moving & ~attempt.inliers if attempt.moving.size else np.zeros_like(attempt.inliers)


def match_parts(attempt: Attempt) -> dict[str, Bools]:
    """The matches of a pair by what they are, (N,) each: without an estimated motion they are tracks only."""
    moving = moving_matches(attempt)
    others = ~attempt.inliers & ~moving
    evaluated = np.full(len(others), attempt.evaluated)
    return {"inliers": attempt.inliers, "outliers": others & evaluated, "moving": moving, "tracks": others & ~evaluated}


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
