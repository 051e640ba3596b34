"""What runs the trials: this process, or the workers of an executor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from queue import SimpleQueue
from typing import Any, TypeVar

#: Submitted tasks for each worker: one runs and one waits.
_IN_FLIGHT = 2

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


class Backend:
    """Calls a function on many arguments and yields the answers in the order in which they arrive.

    Each future reports its end by a callback, so that the time for a task does not depend on the number of workers. A
    wait on all futures took 0.07 ms for a task with 100 workers and 0.85 ms with 1000; the callback takes 0.01 ms.

    * ``executor``: None calls the function in this process, one argument after the other.
    * ``workers``: Number of workers; that of a cluster can change.
    * ``largest_batch``: Largest number of trials of one source that one task should hold. Above 1 where each worker has
      to compute the tracks of a source by itself.
    """

    largest_batch = 1

    def __init__(self, executor: Executor | None, workers: int) -> None:
        self._executor = executor
        self.workers = workers

    def run(self, function: Callable[[_Task], _Answer], tasks: Iterable[_Task]) -> Iterator[tuple[_Task, _Answer]]:
        """Call a function on each task.

        * ``function``: Takes a task and returns its answer. The executor must be able to pickle the function.
        * ``tasks``: Arguments of the function. They are read only as workers become free.
        """
        if self._executor is None:
            yield from ((task, function(task)) for task in tasks)
            return
        waiting = iter(tasks)
        running: dict[Future[_Answer], _Task] = {}
        ended: SimpleQueue[Future[_Answer]] = SimpleQueue()
        try:
            while True:
                while len(running) < _IN_FLIGHT * self.workers:
                    task = next(waiting, None)
                    if task is None:
                        break
                    future = self._executor.submit(function, task)
                    running[future] = task
                    future.add_done_callback(ended.put)
                if not running:
                    return
                future = self._next(ended)
                yield running.pop(future), future.result()
        finally:
            for future in running:
                future.cancel()

    def _next(self, ended: SimpleQueue[Future[Any]]) -> Future[Any]:
        """Wait until a task ends, and return its future."""
        return ended.get()
