"""A cluster in virtual time: the comparison's own loop, journal and tables, with workers that only let time pass.

:class:`SimulatedCluster` is a backend of :func:`slam_init.compare.run.compare`. Each task goes to the worker that is
free first, as on a cluster. The task ends after a drawn time on a virtual clock, and its rows are drawn as well. No
method runs, so the CPU time of the process is that of the comparison alone, for any number of workers.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from queue import SimpleQueue
from typing import Any, ParamSpec, TypeVar

import numpy as np

from slam_init.compare.backend import Backend
from slam_init.compare.messages import TracksAnswer
from slam_init.compare.rows import TrialRow
from slam_init.compare.sources import ComparedSource
from slam_init.compare.trials import Settings, Trial, error_row

#: Mean time of a trial, and time in which a worker makes the tracks of a source that it does not have.
TRIAL_S, TRACKING_S = 1.0, 10.0
#: Logarithmic spread of the times of the trials: one of twenty takes five times the median.
_SPREAD = 1.0

_Arguments = ParamSpec("_Arguments")
_Answer = TypeVar("_Answer")


def simulated_sources(count: int) -> tuple[ComparedSource, ...]:
    """Describe sequences of 200 frames at 30 Hz that do not exist."""
    return tuple(
        ComparedSource(f"clip/{k:05}", f"clip/{k:05}", f"/no/such/clip/{k:05}", 200, 30.0, has_truth=True)
        for k in range(count)
    )


def drawn_row(trial: Trial, settings: Settings) -> TrialRow:
    """Draw the row of a trial; the same trial has the same row."""
    rng = np.random.default_rng((settings.seed, trial.start, *trial.source.label.encode(), *trial.method.encode()))
    row = error_row(trial, settings, "")
    kind = float(rng.uniform())
    if kind < 0.2:
        return replace(row, outcome="none", reason="low_parallax", strict=False, attempts=row.frames_limit)
    error_deg = float(f"{(0.5 if kind < 0.95 else 20.0) * rng.exponential():.6g}")
    return replace(
        row,
        outcome="correct" if error_deg < 5 else "false",
        reason=None,
        strict=error_deg < 1,
        frames_to_accept=int(rng.integers(2, row.frames_limit + 1)),
        rotation_error_deg=error_deg,
        direction_error_deg=error_deg,
        keyframes=f"{trial.start} {trial.start + 5}",
        trial_ms=1e3 * TRIAL_S,
    )


class SimulatedCluster(Backend):
    """Workers in virtual time.

    * ``largest_batch``: As that of a backend.
    * ``virtual``: The executor, with the virtual clock.
    """

    def __init__(self, workers: int, largest_batch: int = 1) -> None:
        self.virtual = VirtualWorkers(workers)
        super().__init__(self.virtual, workers)
        self.largest_batch = largest_batch

    def _next(self, ended: SimpleQueue[Future[Any]]) -> Future[Any]:
        while ended.empty():
            self.virtual.end_one()
        return super()._next(ended)


@dataclass(order=True)
class _Event:
    """The end of a task."""

    end_s: float
    number: int
    future: Future[Any] = field(compare=False)
    answer: TracksAnswer | list[TrialRow] = field(compare=False)


class VirtualWorkers(Executor):
    """The executor of the simulation.

    * ``clock_s``: The virtual time.
    * ``busy_s, tracking_s``: Sum of the times of all workers; and the part of it in which they made tracks.
    * ``largest_open``: Largest number of trials that were submitted and had not ended.
    * ``first_cpu_s, last_cpu_s, drawing_cpu_s``: CPU time of this process at the first submission and at the last
      answer, and that for drawing between them.
    """

    def __init__(self, count: int) -> None:
        self._free = [(0.0, worker) for worker in range(count)]
        self._tracks: list[set[str]] = [set() for _ in range(count)]
        self._events: list[_Event] = []
        self._number = 0
        self._open = 0
        self._rng = np.random.default_rng(0)
        self._settings = Settings()
        self.clock_s = self.busy_s = self.tracking_s = 0.0
        self.largest_open = 0
        self.first_cpu_s = self.last_cpu_s = self.drawing_cpu_s = 0.0

    def submit(
        self, fn: Callable[_Arguments, _Answer], /, *args: _Arguments.args, **kwargs: _Arguments.kwargs
    ) -> Future[_Answer]:
        """Draw the time and the answer of a task; the function is not called."""
        begin = time.process_time()
        self.first_cpu_s = self.first_cpu_s or begin
        (task,) = args
        future: Future[_Answer] = Future()
        free_s, worker = heapq.heappop(self._free)
        end_s = max(free_s, self.clock_s) + self._seconds(task, worker)
        heapq.heappush(self._free, (end_s, worker))
        heapq.heappush(self._events, _Event(end_s, self._number, future, self._answer(task)))
        self._number += 1
        self.drawing_cpu_s += time.process_time() - begin
        return future

    def end_one(self) -> None:
        """Let time pass until a task ends."""
        event = heapq.heappop(self._events)
        self.clock_s = event.end_s
        if isinstance(event.answer, list):
            self._open -= len(event.answer)
        self.last_cpu_s = time.process_time()
        event.future.set_result(event.answer)

    def _seconds(self, task: object, worker: int) -> float:
        """How long a worker takes for a task, with the tracks of a source that it does not have."""
        text = task if isinstance(task, str) else _batch(task)[0].source.text
        tracking_s = 0.0 if text in self._tracks[worker] else TRACKING_S
        self._tracks[worker].add(text)
        self.tracking_s += tracking_s
        trials = 0 if isinstance(task, str) else len(_batch(task))
        # The mean of a logarithmic normal distribution is exp(spread^2 / 2) times its median.
        median_s = TRIAL_S / float(np.exp(0.5 * _SPREAD**2))
        seconds = tracking_s + float(median_s * np.exp(_SPREAD * self._rng.normal(size=trials)).sum())
        self.busy_s += seconds
        return seconds

    def _answer(self, task: object) -> TracksAnswer | list[TrialRow]:
        if isinstance(task, str):
            return TracksAnswer(None, 1e3 * TRACKING_S, "0" * 16)
        rows = [drawn_row(trial, self._settings) for trial in _batch(task)]
        self._open += len(rows)
        self.largest_open = max(self.largest_open, self._open)
        return rows


def _batch(task: object) -> tuple[Trial, ...]:
    if not isinstance(task, tuple):
        raise TypeError(f"a task of a comparison is a source or a batch of trials, not {type(task).__name__}")
    return task
