"""The grey images of the last frames, within a bound of memory: for what needs the images of a map's keyframes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from slam_init.types.arrays import Image
from slam_init.types.frame import Frame


class FrameMemory(Mapping[int, Image]):
    """The images of the last frames, by absolute index.

    * ``max_bytes``: The oldest images are dropped beyond this. The newest one stays in any case.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._bytes = 0
        self._images: dict[int, Image] = {}

    def reading(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Give frames on, and remember their images."""
        for frame in frames:
            self.put(frame)
            yield frame

    def put(self, frame: Frame) -> None:
        """Remember the image of a frame."""
        self._images[frame.index] = frame.gray
        self._bytes += frame.gray.nbytes
        while self._bytes > self._max_bytes and len(self._images) > 1:
            oldest = next(iter(self._images))
            self._bytes -= self._images.pop(oldest).nbytes

    def __getitem__(self, frame: int) -> Image:
        return self._images[frame]

    def __iter__(self) -> Iterator[int]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)
