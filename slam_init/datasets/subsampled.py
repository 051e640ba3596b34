"""Every N-th frame of a source, or its frames at a lower rate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from slam_init.datasets.derived import DerivedSource
from slam_init.datasets.image_files import ImageFileSource, frame_range
from slam_init.datasets.synth import SynthSource
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats, Ints
from slam_init.types.frame import Frame, notes_of

#: Time stamps are exact to this.
_ROUNDING_S = 1e-6


class _Pace:
    """Chooses the frames that are nearest to regular instants, as they come."""

    def __init__(self, fps: float) -> None:
        self._interval_s = 1 / fps
        self._due_s: float | None = None
        self._last_s: float | None = None

    def includes(self, time_s: float) -> bool:
        """Whether a frame is used: the first one that is later than an instant, or earlier by half a frame at most."""
        step_s = 0.0 if self._last_s is None else min(time_s - self._last_s, self._interval_s)
        self._last_s = time_s
        # Times are rounded to microseconds in some containers; without this a frame in the middle would be a lottery.
        ahead_s = time_s + step_s / 2 + _ROUNDING_S
        if self._due_s is None:
            self._due_s = time_s
        if ahead_s < self._due_s:
            return False
        # Several instants within one frame interval count as one: no frame is given twice.
        self._due_s += self._interval_s * (np.floor((ahead_s - self._due_s) / self._interval_s) + 1)
        return True


@dataclass(frozen=True, eq=False)
class SubsampledSource(DerivedSource):
    """A part of the frames of a source. Frames keep their time stamps and, unless renumbered, their indices."""

    #: Every N-th frame is included, from the start frame on.
    every: int = 1
    #: The frames nearest to this rate are included, by their time stamps, from the start frame on. A source with a
    #: lower rate gives all frames.
    fps: float | None = None
    #: Whether the frames that are included from frame 0 on get consecutive indices, as a comparison needs them.
    renumbered: bool = False

    def __post_init__(self) -> None:
        if self.every < 1:
            raise SourceError(f"every {self.every} frames: give 1 or more")
        if self.fps is not None and not 0 < self.fps < np.inf:
            raise SourceError(f"{self.fps!r} frames a second: give a positive number")

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, and which frames are included."""
        taken = (
            f"every {self.every} frames one is used" if self.fps is None else f"at most {self.fps:g} frames a second"
        )
        return (*notes_of(self.source), taken if self.fps is None else f"{taken} are used")

    @cached_property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of the frames that are included from frame 0 on."""
        times_s = self.source.timestamps_s
        return times_s[self._included[self._included < len(times_s)]]  # a bag may hold fewer frames than its index says

    @cached_property
    def _included(self) -> Ints:
        """Absolute indices of the frames that are included from frame 0 on."""
        return self._indices(0)

    def _indices(self, start: int) -> Ints:
        if self.fps is None:
            return np.arange(start, len(self.source), self.every)
        pace = _Pace(self.fps)
        times_s = self.source.timestamps_s[start:].tolist()
        return np.array([start + i for i, time_s in enumerate(times_s) if pace.includes(time_s)], int)

    def __len__(self) -> int:
        return len(self._included)

    def left(self, start: int) -> int:
        """Count the frames that are included from a frame on."""
        return len(self) - start if self.renumbered else len(self._indices(start))

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read the frames that are included, in order.

        * ``start``: Absolute index of the first frame; for renumbered frames their own number.
        """
        if self.renumbered:
            wanted = frame_range(len(self), start, max_frames, self.name)
            positions = {int(self._included[k]): k for k in wanted}
            for frame in self._read(list(positions)):
                yield replace(frame, index=positions[frame.index])
            return
        frame_range(len(self.source), start, max_frames, self.name)
        if self.fps is not None and not self._is_random_access:
            yield from self._paced(start, max_frames)
            return
        yield from self._read(self._indices(start)[:max_frames].tolist())

    @property
    def _is_random_access(self) -> bool:
        """Whether a frame costs nothing before it is read; a video decodes all frames before."""
        return isinstance(self.source, ImageFileSource | SynthSource)

    def _read(self, indices: list[int]) -> Iterator[Frame]:
        if self._is_random_access:
            for index in indices:
                yield from self.source.frames(index, 1)
            return
        wanted = set(indices)
        for frame in self.source.frames(indices[0], indices[-1] - indices[0] + 1):
            if frame.index in wanted:
                yield frame

    def _paced(self, start: int, max_frames: int | None) -> Iterator[Frame]:
        """By the time stamps of the frames themselves, which need not be known before."""
        assert self.fps is not None
        pace, given = _Pace(self.fps), 0
        for frame in self.source.frames(start):
            if pace.includes(frame.timestamp_s):
                yield frame
                given += 1
                if given == max_frames:
                    return
