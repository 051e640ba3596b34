"""Measures the wall-clock time of the stages of the pipeline."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypedDict

import numpy as np

from slam_init.types.arrays import Floats


class StageTimes(TypedDict):
    """Wall-clock times of a stage, in milliseconds, and the number of its calls: the last 108 000 at most.

    ``two_view`` and ``map`` are stages of ``evaluate``, and ``frame`` is all that a frame takes.
    """

    #: Median time of a call.
    median: float
    #: 95th percentile of the times of the calls.
    p95: float
    #: 99th percentile of the times of the calls.
    p99: float
    #: The longest call.
    largest: float
    #: Sum of the times of all calls.
    total: float
    #: Number of calls.
    calls: float


#: Calls of a stage whose times are kept: an hour of video at 30 Hz. The memory is bounded for a stream of any length.
_KEPT = 108_000


class Stopwatch:
    """Collects wall-clock times by stage: ``with stopwatch("track"): ...``. The times of the last hour are kept.

    * ``clock``: Seconds since any instant.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._times_ms: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_KEPT))

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the body of a with statement."""
        begin = self._clock()
        try:
            yield
        finally:
            self._times_ms[stage].append(1e3 * (self._clock() - begin))

    def last_ms(self, stage: str) -> float:
        """Time of the last call of a stage."""
        return self._times_ms[stage][-1]

    def summary(self) -> dict[str, StageTimes]:
        """Summarize the times so far."""
        return {stage: _summary(np.array(times_ms)) for stage, times_ms in self._times_ms.items()}


def _summary(times_ms: Floats) -> StageTimes:
    median, p95, p99 = np.percentile(times_ms, (50, 95, 99)).round(3).tolist()
    largest, total = round(float(times_ms.max()), 3), round(float(times_ms.sum()), 3)
    return {"median": median, "p95": p95, "p99": p99, "largest": largest, "total": total, "calls": len(times_ms)}
