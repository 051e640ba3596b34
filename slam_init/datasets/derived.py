"""A source made from another one: the same sequence with other frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from slam_init.datasets.gyroscope import Gyroscope, gyroscope_of
from slam_init.datasets.image_files import check_size, frame_range
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


@dataclass(frozen=True, eq=False)
class RestatedSource:
    """The frames of a source with another statement of their times, their calibration and their truth."""

    source: TimedSource
    name: str
    kind: str
    camera: Camera | None
    #: (N,) In seconds, strictly increasing; the frames after the last stamp are left out.
    timestamps_s: Floats
    groundtruth: Trajectory | None
    #: What the user should know, for example the unit of the stamps.
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.timestamps_s)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give the frames of the source in order, with these times."""
        wanted = frame_range(len(self), start, max_frames, self.name)
        expected = None if self.camera is None else (self.camera.width, self.camera.height)
        for frame in self.source.frames(start, len(wanted)):
            if expected is not None:
                check_size(f"{self.name}, frame {frame.index}", frame.image.shape[1::-1], expected, "the camera")
            yield replace(frame, timestamp_s=float(self.timestamps_s[frame.index]))
