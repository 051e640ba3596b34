"""Where trials run: here one after the other, on the cores of this machine (loky), or on a Dask cluster.

All three call the same function with the same arguments, so that they give the same results, and keep no more than a
few trials in flight, so that memory does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeVar

from slam_init.errors import ConfigError, SlamInitError

__all__ = ["DASK", "Backend", "open_backend"]

DASK = "dask:"
#: Trials in flight for each worker: one that runs, one that waits.
_IN_FLIGHT = 2

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


class Backend:
    """Runs a function on many arguments, in any order, as answers come.

    Parameters
    ----------
    executor : concurrent.futures.Executor or None
        None runs them here, one after the other.
    workers : int
    """

    def __init__(self, executor: Executor | None, workers: int) -> None:
        self._executor = executor
        self.workers = workers

    def run(self, function: Callable[[_Task], _Answer], tasks: Iterable[_Task]) -> Iterator[tuple[_Task, _Answer]]:
        """Yield (task, answer) as they come; tasks are taken as workers get free."""
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
    """Open a backend by name: ``loky``, ``sequential`` or ``dask:ADDRESS``.

    Parameters
    ----------
    name : str
    jobs : int
        Processes of loky; the others have their own number.

    Raises
    ------
    ConfigError
        Where the name is unknown or its package missing.
    SlamInitError
        Where no Dask scheduler answers.
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

    executor: Any = ProcessPoolExecutor(max_workers=jobs)
    try:
        yield Backend(executor, jobs)
    except BaseException:
        executor.shutdown(wait=False, kill_workers=True)
        raise
    executor.shutdown(wait=True)


@contextmanager
def _dask(address: str) -> Iterator[Backend]:
    try:
        distributed: Any = import_module("distributed")  # has no types
    except ImportError:
        raise ConfigError("the backend dask needs the package distributed: pip install 'slam-init[dask]'") from None
    try:
        client = distributed.Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise SlamInitError(f"no Dask scheduler answers at {address}: {error}") from None
    with client:
        workers = sum(client.nthreads().values())
        if not workers:
            raise SlamInitError(f"the Dask scheduler at {address} has no workers: start some")
        # Not pure: a trial that is run again is to be run, not remembered.
        yield Backend(client.get_executor(pure=False), workers)
