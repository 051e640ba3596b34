"""Data sets of the user: ``python:package.module:attribute``, see ``docs/examples/add_a_data_set.py``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.stamps import image_times, truth_on_clock
from slam_init.errors import SourceError
from slam_init.system.user_code import attribute_of
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

if TYPE_CHECKING:
    from slam_init.datasets.timed import TimedSource

#: Prefix of the name of such a source.
PYTHON = "python:"
_FORM = "give python:package.module:attribute or python:FILE.py:attribute"
#: Attributes of a :class:`slam_init.datasets.timed.TimedSource`.
_REQUIRED_ATTRIBUTES = ("name", "kind", "camera", "groundtruth", "timestamps_s", "frames", "__len__")


def open_python(text: str) -> TimedSource:
    """Open a source by importing an attribute of a module and calling it without arguments.

    * ``text``: ``python:package.module:attribute`` or ``python:FILE.py:attribute``; the call returns a
      :class:`~slam_init.datasets.timed.TimedSource`.
    """
    try:
        source: TimedSource = attribute_of(text.removeprefix(PYTHON))()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise SourceError(f"{text}: cannot be opened ({error}): {_FORM}") from error
    if missing := [name for name in _REQUIRED_ATTRIBUTES if not hasattr(source, name)]:
        raise SourceError(f"{text}: the returned object is not a source: it has no {missing[0]}")
    return _with_checked_times(text, source)


def _with_checked_times(text: str, source: TimedSource) -> TimedSource:
    """The source itself where its time stamps are seconds; otherwise one that converts them."""
    try:
        stamps = np.asarray(source.timestamps_s, float)
        count = len(source)
    except (TypeError, ValueError):
        raise SourceError(f"{text}: timestamps_s is not an array of numbers: give one time for each frame") from None
    if stamps.shape != (count,) or count == 0:
        raise SourceError(f"{text}: timestamps_s has the shape {stamps.shape} for {count} frames: give one for each")
    for index, pose in enumerate(() if source.groundtruth is None else source.groundtruth.world_from_cam):
        if problem := pose.problem():
            raise SourceError(f"{text}: groundtruth: pose {index} {problem}")
    times_s, notes = image_times(stamps.tolist(), [f"{text}: frame {index}" for index in range(count)])
    if not notes:
        return source
    truth, truth_notes = truth_on_clock(source.groundtruth, times_s)
    return ConvertedSource(source, times_s, truth, (*notes, *truth_notes))


@dataclass(frozen=True, eq=False)
class ConvertedSource:
    """A source of the user whose time stamps are converted to seconds."""

    #: The source of the user.
    source: TimedSource
    #: (N,) In seconds, strictly increasing.
    timestamps_s: Floats
    #: On the same clock.
    groundtruth: Trajectory | None
    #: The unit of the stamps, for the user.
    notes: tuple[str, ...]

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

    def __len__(self) -> int:
        return len(self.source)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give the frames of the source, with times in seconds."""
        for frame in self.source.frames(start, max_frames):
            yield replace(frame, timestamp_s=float(self.timestamps_s[frame.index]))
