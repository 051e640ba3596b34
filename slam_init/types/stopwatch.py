"""Measures the wall-clock time of the stages of the pipeline."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypedDict

import numpy as np

from slam_init.types.arrays import Ints


class StageTimes(TypedDict):
    """Wall-clock times of a stage, in milliseconds, and the number of its calls.

    ``two_view`` and ``map`` are stages of ``judge``, and ``frame`` is all that a frame takes.
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
    #: Number of calls that take less than 1, 2, 5, 10, 20, 33, 50, 100, 200, 500, 1000 ms and not less than the one
    #: before; then those that take longer.
    histogram: list[int]


#: Edges of the histograms, in milliseconds.
_EDGES_MS = (1.0, 2.0, 5.0, 10.0, 20.0, 33.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


#: Calls whose times are kept one by one: an hour of video at 30 Hz, in 1.7 MB for each stage.
_KEPT = 108_000


class Stopwatch:
    """Collects wall-clock times by stage: ``with stopwatch("track"): ...``.

    The quantiles are those of the last calls: an hour of video at least. The number, the sum, the largest time and the
    histogram are those of all calls. So the memory is bounded for a video of any length.

    * ``clock``: Seconds since any instant.
    * ``kept``: Calls of a stage whose times are kept; up to twice as many until the oldest are dropped.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter, kept: int = _KEPT) -> None:
        self._clock = clock
        self._kept = kept
        self._stages: dict[str, _Stage] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the body of a with statement."""
        begin = self._clock()
        try:
            yield
        finally:
            times = self._stages.setdefault(stage, _Stage(self._kept))
            times.add(1e3 * (self._clock() - begin))

    def last_ms(self, stage: str) -> float:
        """Time of the last call of a stage."""
        return self._stages[stage].samples_ms[-1]

    def summary(self) -> dict[str, StageTimes]:
        """Summarize the times so far."""
        return {name: stage.summary() for name, stage in self._stages.items()}


class _Stage:
    """The times of a stage: the last ones one by one, and counts of those before."""

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self.samples_ms: array[float] = array("d")  # eight bytes for a call
        self._calls = 0
        self._total_ms = self._largest_ms = 0.0
        self._histogram = np.zeros(len(_EDGES_MS) + 1, np.int64)

    def add(self, time_ms: float) -> None:
        self.samples_ms.append(time_ms)
        if len(self.samples_ms) >= 2 * self._kept:
            self._calls, self._total_ms, self._largest_ms, self._histogram = self._counts(self.samples_ms[: self._kept])
            del self.samples_ms[: self._kept]

    def _counts(self, samples_ms: array[float]) -> tuple[int, float, float, Ints]:
        """Number, sum, maximum and histogram of the calls that were dropped and of some more."""
        bins = np.searchsorted(_EDGES_MS, samples_ms, side="right")
        return (
            self._calls + len(samples_ms),
            self._total_ms + float(np.sum(samples_ms)),
            max(self._largest_ms, float(np.max(samples_ms))),
            self._histogram + np.bincount(bins, minlength=len(_EDGES_MS) + 1),
        )

    def summary(self) -> StageTimes:
        calls, total_ms, largest_ms, histogram = self._counts(self.samples_ms)
        median_ms, p95_ms, p99_ms = (float(one) for one in np.percentile(self.samples_ms, (50, 95, 99)))
        return {
            "median": round(median_ms, 3),
            "p95": round(p95_ms, 3),
            "p99": round(p99_ms, 3),
            "largest": round(largest_ms, 3),
            "total": round(total_ms, 3),
            "calls": calls,
            "histogram": histogram.tolist(),
        }
