"""Time stamps of data sets: checked where they are read, and converted to seconds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_init.datasets.text import Row, numbers, trajectory
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.pose import Trajectory
from slam_init.types.time_stamps import LARGEST_STAMP, TimeUnit, in_seconds, problem_of, time_unit, unit_notes

# A true pose belongs to an image if their time stamps differ by no more than this.
_TOLERANCE_S = 0.02


def stamp_of(row: Row, fields: list[str], what: str) -> float:
    """Parse the first field of a line as a time stamp in any unit."""
    (stamp,) = numbers(row, fields, 1, what)
    if problem := problem_of(stamp):
        raise SourceError(f"{row[0]}: time stamp {fields[0][:40]} {problem}")
    return stamp


def image_times(
    stamps: Sequence[float], places: Sequence[str], stated: TimeUnit = TimeUnit.SECONDS
) -> tuple[Floats, tuple[str, ...]]:
    """Check that the time stamps of images increase, and convert them to seconds.

    Shapes: returns ``timestamps_s`` (N,).
    """
    raw = np.array(stamps, float)
    _check(raw, raw, places)
    unit = time_unit(raw, stated)
    times_s = in_seconds(raw, unit)
    _check(times_s, raw, places)
    return times_s, unit_notes("the time stamps", unit, stated)


def _check(times: Floats, raw: Floats, places: Sequence[str]) -> None:
    """Raise the problem of the first time that has one; the message tells the stamp that it comes from."""
    previous = np.concatenate([[-1.0], times[:-1]])
    with np.errstate(invalid="ignore"):
        suspects = np.flatnonzero(~((times > previous) & (times >= 0) & (raw < LARGEST_STAMP)))
    for at in suspects[:1].tolist():
        stamp = float(raw[at])
        shown = f"{stamp:.0f}" if stamp.is_integer() else repr(stamp)
        problem = problem_of(float(times[at]), None if at == 0 else float(previous[at]))
        raise SourceError(f"{places[at]}: time stamp {shown} {problem}")


def truth_on_clock(
    truth: Trajectory | None, timestamps_s: Floats, stated: TimeUnit = TimeUnit.SECONDS
) -> tuple[Trajectory | None, tuple[str, ...]]:
    """Convert the stamps of a true trajectory to seconds on the clock of the images.

    Poses may come at any rate, so that their step tells nothing. Their unit is the one in which most images have a true
    pose; the stated one if no other gives more.

    Shapes: ``timestamps_s`` (N,).
    """
    if truth is None:
        return None, ()
    matched = {unit: _matched(in_seconds(truth.timestamps_s, unit), timestamps_s) for unit in (stated, *TimeUnit)}
    unit = max(matched, key=matched.__getitem__)  # of equal ones the first, which is the stated one
    notes = unit_notes("the time stamps of the ground truth", unit, stated)
    if unit == TimeUnit.SECONDS:
        return truth, notes
    stamps = in_seconds(truth.timestamps_s, unit).tolist()
    return trajectory(zip(stamps, truth.world_from_cam, strict=True)), notes


def line_by_line(stamps: Floats, timestamps_s: Floats) -> bool:
    """Whether the stamps of poses, in any unit, differ from the times of the images by an offset alone.

    Shapes: ``stamps`` (M,), ``timestamps_s`` (N,).
    """
    if len(stamps) != len(timestamps_s):
        return False
    passed_s, since_first = timestamps_s - timestamps_s[0], stamps - stamps[0]
    return any((np.abs(in_seconds(since_first, unit) - passed_s) <= _TOLERANCE_S).all() for unit in TimeUnit)


def _matched(truth_s: Floats, timestamps_s: Floats) -> int:
    """How many images have a true pose near in time."""
    bounded = np.concatenate([[-np.inf], truth_s, [np.inf]])
    after = np.searchsorted(truth_s, timestamps_s)
    nearest = np.minimum(timestamps_s - bounded[after], bounded[after + 1] - timestamps_s)
    return int((nearest <= _TOLERANCE_S).sum())
