"""The interface of a recorder: the pipeline reports each step of a run to it.

A :class:`Recorder` ignores all reports. A :class:`StoryRecorder` keeps what the picture of a run shows, in small
images: its last frames with their tracks, the last pair, the keyframes of its map.
:class:`slam_init.recording.rerun_recorder.RerunRecorder` writes them to a file for the Rerun viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.result import Attempt
from slam_init.types.scale import Scale
from slam_init.types.status import CameraPose


class Recorder:
    """Receives the reports of a run and ignores them. It is also a context manager that closes itself."""

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Report a frame and its tracks. The reports that follow belong to this frame."""

    def attempt(self, attempt: Attempt) -> None:
        """Report an attempt."""

    def frame_time(self, elapsed_ms: float) -> None:
        """Report what a frame took."""

    def row_times(self, observations: Observations, corrected: Floats) -> None:
        """Report what the correction of a rolling shutter moves in a frame.

        Shapes: ``corrected`` (N, 2).

        * ``corrected``: Their pixels as if all rows were taken at the time of the middle one.
        """

    def waiting(self, pose: CameraPose) -> None:
        """Report what is known of the pose of the newest camera while there is no map."""

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Report an accepted map."""

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """Report, at the end, the two maps that the views could not decide between, the better one first."""

    def continued(self, keyframe: Keyframe) -> None:
        """Report a frame after the initialization that was located in the map."""

    def refined(self, map_: InitialMap) -> None:
        """Report the accepted map as it has grown."""

    def scaled(self, scale: Scale) -> None:
        """Report the scale of the last map."""

    def restarted(self) -> None:
        """Report that the map was lost, and that the initialization restarts."""

    def close(self) -> None:
        """End the reports. It may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.close()


# -- the story of a run ----------------------------------------------------------------------------

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
