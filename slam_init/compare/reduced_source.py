"""A source of large images at the size at which they are tracked, as ``slam-init run`` reduces them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slam_init.datasets.derived import DerivedSource
from slam_init.mapping.reduction import Reduction
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, notes_of

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource


@dataclass(frozen=True, eq=False)
class ReducedSource(DerivedSource):
    """A source whose frames are reduced."""

    reduction: Reduction

    @property
    def camera(self) -> Camera | None:
        """The camera of the reduced frames."""
        return self.reduction.camera

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source and of the reduction."""
        return (*notes_of(self.source), *self.reduction.notes)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read and reduce frames in order."""
        yield from self.reduction.frames(self.source.frames(start, max_frames))


def reduced(source: TimedSource) -> TimedSource:
    """Reduce the frames of a source if they are large.

    * Returns: The source itself where its images are not large, or have no calibration.
    """
    if source.camera is None:
        return source
    reduction = Reduction.for_camera(source.camera)
    return source if reduction.factor == 1 else ReducedSource(source, reduction)
