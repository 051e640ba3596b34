"""Data sets of the user: ``python:package.module:attribute``, see ``docs/examples/add_a_data_set.py``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.derived import RestatedSource
from slam_init.datasets.stamps import image_times, truth_on_clock
from slam_init.errors import SourceError
from slam_init.system.user_code import attribute_of

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
    notes = (*notes, *truth_notes)
    return RestatedSource(source, source.name, source.kind, source.camera, times_s, truth, notes)
