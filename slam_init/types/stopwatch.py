"""Measures the wall-clock time of the stages of the pipeline."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypedDict

import numpy as np

__all__ = ["StageTimes", "Stopwatch"]


class StageTimes(TypedDict):
    """Wall-clock times of a stage, in milliseconds, and the number of its calls.

    Of a judgement that runs in slices, the stages ``two_view`` and ``map`` are those of the whole judgement without its
    pauses, ``judge`` is the slice of a frame, and ``frame`` is all that a frame takes.

    Attributes
    ----------
    median : float
        Median time of a call.
    p95 : float
        95th percentile of the times of the calls.
    p99 : float
        99th percentile of the times of the calls.
    largest : float
        The longest call.
    total : float
        Sum of the times of all calls.
    calls : float
        Number of calls.
    histogram : list of int
        Number of calls that take less than 1, 2, 5, 10, 20, 33, 50, 100, 200, 500, 1000 ms and not less than the one
        before; then those that take longer.
    """

    median: float
    p95: float
    p99: float
    largest: float
    total: float
    calls: float
    histogram: list[int]


#: Edges of the histograms, in milliseconds.
_EDGES_MS = (1.0, 2.0, 5.0, 10.0, 20.0, 33.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


class Stopwatch:
    """Collects wall-clock times by stage: ``with stopwatch("track"): ...``.

    Parameters
    ----------
    clock : callable, optional
        Seconds since any instant.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._samples_ms: dict[str, array[float]] = {}  # an array takes eight bytes per call

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the body of a with statement."""
        begin = self._clock()
        try:
            yield
        finally:
            self._samples_ms.setdefault(stage, array("d")).append(1e3 * (self._clock() - begin))

    def last_ms(self, stage: str) -> float:
        """Time of the last call of a stage.

        Parameters
        ----------
        stage : str
            It has been called.

        Returns
        -------
        float
            In milliseconds.
        """
        return self._samples_ms[stage][-1]

    def summary(self) -> dict[str, StageTimes]:
        """Summarize the times so far.

        Returns
        -------
        dict of str to StageTimes
            By stage.
        """
        return {
            stage: {
                "median": round(float(np.median(samples)), 3),
                "p95": round(float(np.percentile(samples, 95)), 3),
                "p99": round(float(np.percentile(samples, 99)), 3),
                "largest": round(float(np.max(samples)), 3),
                "total": round(float(np.sum(samples)), 3),
                "calls": len(samples),
                "histogram": np.bincount(
                    np.searchsorted(_EDGES_MS, samples, side="right"), minlength=len(_EDGES_MS) + 1
                ).tolist(),
            }
            for stage, samples in self._samples_ms.items()
        }
