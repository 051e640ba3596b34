"""What runs the trials: this process, or the workers of an executor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, TypeVar

__all__ = ["Backend"]

#: Submitted trials for each worker: one runs and one waits.
_IN_FLIGHT = 2

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


class Backend:
    """Calls a function on many arguments and yields the answers in the order in which they arrive.

    Parameters
    ----------
    executor : concurrent.futures.Executor or None
        None calls the function in this process, one argument after the other.
    workers : int
        Number of workers of the executor.
    """

    def __init__(self, executor: Executor | None, workers: int) -> None:
        self._executor = executor
        self.workers = workers

    def run(self, function: Callable[[_Task], _Answer], tasks: Iterable[_Task]) -> Iterator[tuple[_Task, _Answer]]:
        """Call a function on each task.

        Parameters
        ----------
        function : callable
            Takes a task and returns its answer. The executor must be able to pickle the function.
        tasks : iterable
            Arguments of the function. They are read only as workers become free.

        Yields
        ------
        (task, answer)
            In the order in which the answers arrive.
        """
        if self._executor is None:
            yield from ((task, function(task)) for task in tasks)
            return
        waiting = iter(tasks)
        running: dict[Future[_Answer], _Task] = {}
        try:
            while True:
                while len(running) < _IN_FLIGHT * self.workers:
                    task = next(waiting, None)
                    if task is None:
                        break
                    running[self._executor.submit(function, task)] = task
                if not running:
                    return
                for future in self._done(running):
                    yield running.pop(future), future.result()
        finally:
            for future in running:
                future.cancel()

    def _done(self, running: Iterable[Future[Any]]) -> set[Future[Any]]:
        """Wait until a task ends, and return the tasks that have ended."""
        return set(wait(running, return_when=FIRST_COMPLETED).done)
