"""Backends that run trials: sequentially in this process, on the cores of this machine (loky), or on a Dask cluster.

All three backends call the same function with the same arguments, so they give the same results. They submit only a few
trials at a time, so memory does not grow with the number of trials.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeVar

from slam_init.compare.guard import end_with_parent
from slam_init.errors import ConfigError, SlamInitError

__all__ = ["DASK", "Backend", "open_backend"]

DASK = "dask:"
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
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield running.pop(future), future.result()
        finally:
            for future in running:
                future.cancel()


@contextmanager
def open_backend(name: str, jobs: int) -> Iterator[Backend]:
    """Open a backend by name.

    Parameters
    ----------
    name : str
        ``loky``, ``sequential`` or ``dask:ADDRESS``, with the address of a Dask scheduler.
    jobs : int
        Number of processes of loky; the other backends do not use it.

    Yields
    ------
    Backend
        It is closed at the end of the ``with`` block.

    Raises
    ------
    ConfigError
        If the name is unknown, or its package is not installed.
    SlamInitError
        If no Dask scheduler answers at the address, or the scheduler has no workers.
    """
    if name == "sequential":
        yield Backend(None, 1)
    elif name == "loky":
        with _loky(jobs) as backend:
            yield backend
    elif name.startswith(DASK) and name != DASK:
        with _dask(name.removeprefix(DASK)) as backend:
            yield backend
    else:
        raise ConfigError(f"unknown backend {name!r}: use loky, sequential or dask:ADDRESS")


@contextmanager
def _loky(jobs: int) -> Iterator[Backend]:
    from loky import ProcessPoolExecutor

    # The package has no type annotations. A worker that computes does not notice that its parent is gone.
    executor = ProcessPoolExecutor(max_workers=jobs, initializer=end_with_parent, initargs=(os.getpid(),))
    try:
        yield Backend(executor, jobs)
    except BaseException:
        executor.shutdown(wait=False, kill_workers=True)
        raise
    executor.shutdown(wait=True)


@contextmanager
def _dask(address: str) -> Iterator[Backend]:
    try:
        distributed: Any = import_module("distributed")  # the package has no type annotations
    except ImportError:
        raise ConfigError("the backend dask needs the package distributed: pip install 'slam-init[dask]'") from None
    try:
        client = distributed.Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise SlamInitError(f"no Dask scheduler answers at {address}: {error}") from None
    with client:
        workers = sum(client.nthreads().values())
        if not workers:
            raise SlamInitError(f"the Dask scheduler at {address} has no workers: start at least one")
        # pure=False: Dask must not reuse the answer of an earlier call with equal arguments.
        yield Backend(client.get_executor(pure=False), workers)
