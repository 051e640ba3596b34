"""Summaries of results that were not made by a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from make_map import CAMERAS

from slam_init.output.summary import Summary, summary_of
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.result import Result


@dataclass
class FakeSource:
    """A source with a name and without frames."""

    name: str = "arc"
    kind: str = "images"
    camera: Camera | None = None
    groundtruth = None

    def __len__(self) -> int:
        return 32

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        return iter(())


def summarize(result: Result, camera: Camera = CAMERAS["pinhole"], **keywords) -> Summary:
    """The summary of a result of the method ``quest``."""
    return summary_of(result, FakeSource(), camera, "quest", 0, **keywords)
