"""Sources whose frames have the direction of gravity: of a table, or of an accelerometer while it rests.

A line of a table is ``TIME x y z`` or ``NAME x y z``, with commas or spaces: the time stamp of the frame in seconds, of
which the nearest one within 20 ms is taken, or the name of its file; and a vector down in the axes of the camera (x
right, y down, z forward), of any length but zero. A fifth column states its standard deviation, by default 1 degree.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from slam_init.datasets.text import fields_of, numbers, read_rows
from slam_init.datasets.views import DerivedSource
from slam_init.errors import SlamInitError, SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.frame import Frame, notes_of
from slam_init.types.inertial import Gravity, InertialRecord

#: Half of the interval between two frames of a video.
#: Class: geometry.
_NEAR_S = 0.02
_SIGMA_DEG = 1.0


@dataclass(frozen=True, eq=False)
class GravitySource(DerivedSource):
    """A source whose frames have the direction of gravity.

    * ``source``: Gives the frames.
    """

    #: Gives the gravity in a frame, or None where it is not known.
    gravity_of: Callable[[Frame], Gravity | None]
    note: str = "the frames have gravity of a function"
    #: Frames read last, with gravity and in all.
    _count: list[int] = field(default_factory=lambda: [0, 0])

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, where gravity is from, and how many of the frames that were read last have it."""
        known, total = self._count
        return (*notes_of(self.source), f"{self.note}: {known} of {total}" if total else self.note)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order, with gravity."""
        self._count[:] = 0, 0
        for frame in self.source.frames(start, max_frames):
            gravity = self.gravity_of(frame)
            self._count[0] += gravity is not None
            self._count[1] += 1
            yield replace(frame, gravity=gravity)


def at_rest(record: InertialRecord) -> Callable[[Frame], Gravity | None]:
    """Make the function that gives gravity in the frames during which an accelerometer rests."""
    return lambda frame: record.gravity_at(frame.timestamp_s)


def read_gravity(path: str | os.PathLike[str]) -> Callable[[Frame], Gravity | None]:
    """Read a table, and make the function that gives gravity in a frame of it."""
    table = user_path(path)
    named: dict[str, Gravity] = {}
    timed: dict[float, Gravity] = {}
    for row in read_rows(table):
        key, *fields = fields_of(row)
        values = numbers(row, fields, 4 if len(fields) > 3 else 3, "TIME or NAME, x, y, z and perhaps degrees")
        try:
            gravity = Gravity(np.array(values[:3]), *(values[3:] or [_SIGMA_DEG]))
        except SlamInitError as error:
            raise SourceError(f"{row[0]}: {error}") from None
        try:
            timed[float(key)] = gravity
        except ValueError:
            named[key] = gravity
    if not (named or timed):
        raise SourceError(f"{table}: holds no direction of gravity: write lines of TIME x y z or NAME x y z")
    if not all(map(math.isfinite, timed)):
        raise SourceError(f"{table}: a time stamp is not finite: give seconds")
    times_s = np.array(sorted(timed))

    def gravity_of(frame: Frame) -> Gravity | None:
        if frame.name in named or not len(times_s):
            return named.get(frame.name)
        nearest = float(times_s[np.argmin(np.abs(times_s - frame.timestamp_s))])
        return timed[nearest] if abs(nearest - frame.timestamp_s) <= _NEAR_S else None

    return gravity_of
