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

    Attributes
    ----------
    median : float
        Median time of a call.
    p95 : float
        95th percentile of the times of the calls.
    total : float
        Sum of the times of all calls.
    calls : float
        Number of calls.
    """

    median: float
    p95: float
    total: float
    calls: float


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
                "total": round(float(np.sum(samples)), 3),
                "calls": len(samples),
            }
            for stage, samples in self._samples_ms.items()
        }
