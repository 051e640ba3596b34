"""The unit of time stamps, and what a time stamp may be. This module is the only one that decides either.

The project's times are seconds. Files and cameras give seconds, milliseconds, microseconds or nanoseconds, often under
a name that says something else. The unit is decided by these rules, in this order:

1. The unit that the format states (seconds but for EuRoC) stays if the median step between two stamps is then 0.5 ms to
   10 s, and the first stamp lies before :data:`LARGEST_SECONDS`. Where the first stamp is a date of this century in
   seconds, the step may have 1000 s: such stamps belong to photographs that are taken one by one.
2. Otherwise the unit in which the median step has 2 ms to 2 s. There is at most one, because two units differ by a
   factor of 1000.
3. Otherwise, as for a single stamp: the first unit, from the stated one on, in which the first stamp lies before
   :data:`LARGEST_SECONDS`.

Each stamp is a finite number, is not negative, lies below 2^63 (what a counter of nanoseconds holds), and comes after
the one before. A source that breaks this is refused with one line; see :func:`problem_of`.
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np

from slam_init.types.arrays import Floats

#: No camera gives such a time in seconds: it is the year 5138. In milliseconds it is a day in 1973.
LARGEST_SECONDS = 1e11

#: Counters of nanoseconds are signed integers of 64 bits. A stamp lies below this, in any unit.
LARGEST_STAMP = 2.0**63

# Rule 1: steps that are credible in the unit that the format states.
_STATED_STEP_S = (0.0005, 10.0)
_DATED_STEP_S = 1000.0
# Rule 2: the range spans a factor of 1000, which is that between two units. 500 images a second to one in 2 s.
_USUAL_STEP_S = (0.002, 2.0)
# The years 2000 to 2100 in seconds since 1970. Stamps that count from the start of a device do not come so far.
_CENTURY_S = (9.46e8, 4.1e9)


class TimeUnit(StrEnum):
    """A unit of time stamps."""

    SECONDS = "seconds"
    MILLISECONDS = "milliseconds"
    MICROSECONDS = "microseconds"
    NANOSECONDS = "nanoseconds"

    @property
    def per_second(self) -> float:
        """How many of the unit are a second."""
        return 1e3 ** list(TimeUnit).index(self)


def time_unit(stamps: Floats, stated: TimeUnit = TimeUnit.SECONDS) -> TimeUnit:
    """Decide the unit of time stamps by their step and their size.

    Shapes: ``stamps`` (N,).
    """
    first, steps = float(stamps[0]), np.diff(stamps)
    possible = [unit for unit in (stated, *TimeUnit) if first / unit.per_second < LARGEST_SECONDS]
    if len(steps):
        step = float(np.median(steps))
        dated = stated == TimeUnit.SECONDS and is_date(first)
        low_s, high_s = _STATED_STEP_S[0], _DATED_STEP_S if dated else _STATED_STEP_S[1]
        if stated in possible and low_s <= step / stated.per_second <= high_s:
            return stated
        for unit in possible:
            if _USUAL_STEP_S[0] <= step / unit.per_second < _USUAL_STEP_S[1]:
                return TimeUnit(unit)
    return TimeUnit(possible[0]) if possible else stated


def is_date(stamp_s: float) -> bool:
    """Whether seconds are a date of this century, and no time since a clock was started."""
    return _CENTURY_S[0] <= stamp_s <= _CENTURY_S[1]


def in_seconds(stamps: Floats, unit: TimeUnit) -> Floats:
    """Convert time stamps to seconds.

    Shapes: ``stamps`` (N,), returns (N,).
    """
    return stamps if unit == TimeUnit.SECONDS else np.asarray(stamps / unit.per_second)


def problem_of(stamp: float, previous: float | None = None) -> str | None:
    """Find what is wrong with a time stamp.

    * Returns: The rest of a sentence that starts with the stamp, and the remedy; None if nothing is wrong.
    """
    if not math.isfinite(stamp):
        return "is not a finite number: give seconds"
    if stamp < 0:
        return "is negative: shift the times so that they start at 0 or later"
    if stamp >= LARGEST_STAMP:
        return "is beyond 2^63, more than a counter of nanoseconds holds: give seconds"
    if stamp == previous:
        return "does not come after the one before, it is the same: give each frame its own time, with all decimals"
    if previous is not None and stamp < previous:
        return "does not come after the one before: sort the frames by time, and give each time once"
    return None


def unit_notes(what: str, unit: TimeUnit, stated: TimeUnit = TimeUnit.SECONDS) -> tuple[str, ...]:
    """Tell a unit that the format did not state."""
    return () if unit == stated else (f"{what} are taken as {unit}, by their size and step",)
