"""The times of a stream of frames: checked when a frame comes, and converted to seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import History
from slam_init.types.time_stamps import LARGEST_SECONDS, TimeUnit, in_seconds, problem_of, time_unit, unit_notes


class FrameClock:
    """Decides the unit of the time stamps of a stream, and checks each stamp.

    The stamps of a stream come one by one, so that its first stamp decides the unit by its size, and the second one by
    the step between them, by the rules of :mod:`slam_init.types.time_stamps`. If the second one decides for another
    unit, the time of the first frame is corrected in the history. From then on the unit stays. A frame of a source has
    seconds already, so that only the size of its stamp counts.

    * ``history``: The frames up to now.
    """

    def __init__(self, history: History) -> None:
        self._history = history
        self._unit = TimeUnit.SECONDS
        self._stamps_read = 0
        self._last_stamp: float | None = None
        self._stamp_before: float | None = None
        self._last_s: float | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        return unit_notes("the time stamps", self._unit)

    def stamped(self, frame: Frame, *, in_seconds_by_type: bool) -> Frame:
        """Check the time stamp of the next frame, and convert it to seconds.

        * ``in_seconds_by_type``: Whether the frame comes from a source or has no time of its own, so that the step
          decides nothing.
        """
        stamp = frame.timestamp_s
        if problem := problem_of(stamp, self._last_stamp):
            raise SlamInitError(f"frame {frame.index}: time stamp {stamp!r} {problem}")
        if self._stamps_read == 0:
            self._unit = time_unit(np.array([stamp]))
        elif self._stamps_read == 1 and not in_seconds_by_type and self._last_stamp is not None:
            self._decide_by_step(self._last_stamp, stamp)
        self._stamps_read += 1
        self._stamp_before, self._last_stamp = self._last_stamp, stamp
        return frame if self._unit == TimeUnit.SECONDS else replace(frame, timestamp_s=self._seconds(stamp))

    def give_back(self) -> None:
        """Forget the newest stamp, whose frame was not taken. A unit that it decided stays."""
        self._stamps_read -= 1
        self._last_stamp = self._stamp_before

    def check_tracks(self, current: Observations) -> None:
        """Check the time of tracks from elsewhere, which is in seconds."""
        time_s = current.timestamp_s
        problem = problem_of(time_s, self._last_s)
        if problem is None and time_s >= LARGEST_SECONDS:
            problem = "is no time in seconds: divide nanoseconds by 1e9, milliseconds by 1e3"
        if problem is not None:
            raise SlamInitError(f"frame {current.frame}: time stamp {time_s!r} {problem}")

    def took(self, current: Observations) -> None:
        """Remember the time of tracks that were taken."""
        self._last_s = current.timestamp_s

    def _decide_by_step(self, first: float, second: float) -> None:
        unit = time_unit(np.array([first, second]))
        if unit == self._unit:
            return
        self._unit = unit
        for earlier in self._history:
            self._history.put(replace(earlier, timestamp_s=self._seconds(first)))

    def _seconds(self, stamp: float) -> float:
        return float(in_seconds(np.array([stamp]), self._unit)[0])
