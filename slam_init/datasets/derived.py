"""A source made from another one: the same sequence with other frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from slam_init.datasets.gyroscope import Gyroscope, gyroscope_of
from slam_init.datasets.timed import TimedSource
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory


@dataclass(frozen=True, eq=False)
class DerivedSource:
    """A :class:`slam_init.datasets.timed.TimedSource` that is like another one, but for what a subclass changes."""

    source: TimedSource

    @property
    def name(self) -> str:
        """That of the source."""
        return self.source.name

    @property
    def kind(self) -> str:
        """That of the source."""
        return self.source.kind

    @property
    def camera(self) -> Camera | None:
        """That of the source."""
        return self.source.camera

    @property
    def groundtruth(self) -> Trajectory | None:
        """That of the source."""
        return self.source.groundtruth

    @property
    def gyroscope(self) -> Gyroscope | None:
        """That of the source."""
        return gyroscope_of(self.source)

    @property
    def timestamps_s(self) -> Floats:
        """Those of the source."""
        return self.source.timestamps_s

    def __len__(self) -> int:
        return len(self.source)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give the frames of the source."""
        yield from self.source.frames(start, max_frames)
