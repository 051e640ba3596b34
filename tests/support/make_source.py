"""Sources for tests: one that renders each frame once, and one of given frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from slam_init.datasets import open_source
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Source
from slam_init.types.pose import Trajectory


@dataclass
class KeptSource:
    """A source that keeps the frames of another source, so that each frame is rendered once."""

    source: Source
    kept: dict[int, Frame] = field(default_factory=dict)

    def __getattr__(self, name: str):
        return getattr(self.source, name)

    def __len__(self) -> int:
        return len(self.source)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        stop = len(self) if max_frames is None else min(len(self), start + max_frames)
        for index in range(start, stop):
            if index not in self.kept:
                (self.kept[index],) = self.source.frames(index, 1)
            yield self.kept[index]


@dataclass(frozen=True)
class GivenFrames:
    """A source of given frames."""

    camera: Camera
    given: tuple[Frame, ...]
    groundtruth: Trajectory | None = None
    name: str = "given"
    kind: str = "images"

    def __len__(self) -> int:
        return len(self.given)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        stop = len(self) if max_frames is None else start + max_frames
        return iter(self.given[start:stop])


def synth(name: str, seed: int = 0, **options: float) -> KeptSource:
    """The source ``synth:NAME`` with these options."""
    query = "&".join(f"{key}={value}" for key, value in options.items())
    return KeptSource(open_source(f"synth:{name}?{query}", seed))


def picked(source: Source, indices: Sequence[int]) -> tuple[Frame, ...]:
    """These frames of a source, numbered from 0, at 30 Hz."""
    frames = [next(source.frames(index, 1)) for index in indices]
    return tuple(replace(frame, index=k, timestamp_s=k / 30) for k, frame in enumerate(frames))
