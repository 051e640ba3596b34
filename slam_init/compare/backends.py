"""Backends that run trials: sequentially in this process, on the cores of this machine (loky), or on a Dask cluster.

All three backends call the same function with the same arguments, so they give the same results. They submit only a few
trials at a time, so memory does not grow with the number of trials.
"""

from __future__ import annotations

import errno
import logging
import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from importlib import import_module, metadata
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from slam_init.errors import ConfigError, SlamInitError
from slam_init.system.process_guard import end_with_parent

DASK = "dask:"
#: Submitted tasks for each worker: one runs and one waits.
_IN_FLIGHT = 2
#: No further file, process, memory or place may be had.
_NO_MORE = (errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM, errno.ENOSPC, errno.EROFS, errno.EACCES)
#: A scheduler has to answer within this time.
_CONNECT = "10s"
#: A cluster may replace its workers, but not for longer than this. It is looked at this often.
_WITHOUT_WORKERS_S, _POLL_S = 60.0, 5.0
#: Trials of one source in one task. A worker that has no tracks of the source computes them, which takes as long as ten
#: or more trials on a sequence of 1000 frames. A comparison that is killed runs the trials of open batches again.
_LARGEST_BATCH = 50
#: HOST:PORT, with a protocol or without; an address of IPv6 is in brackets.
_ADDRESS = re.compile(r"([a-z]{1,9}://)?(\[[0-9a-fA-F:.]{2,45}\]|[\w.-]{1,255}):\d{1,5}")

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


@contextmanager
def open_backend(name: str, jobs: int, sources: Sequence[str] = ()) -> Iterator[Backend]:
    """Open a backend by name.

    * ``name``: ``loky``, ``sequential`` or ``dask:ADDRESS``, with the address of a Dask scheduler.
    * ``jobs``: Number of processes of loky; the other backends do not use it.
    * ``sources``: Files and folders that the workers of a cluster need.
    """
    if name == "sequential":
        yield Backend(None, 1)
    elif name == "loky":
        with _loky(jobs) as backend:
            yield backend
    elif name.startswith(DASK) and name != DASK:
        with _cluster(name.removeprefix(DASK), sources) as backend:
            yield backend
    else:
        raise ConfigError(f"unknown backend {name!r}: use loky, sequential or dask:ADDRESS")


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


# -- this machine ----------------------------------------------------------------------------------


@contextmanager
def _loky(jobs: int) -> Iterator[Backend]:
    from loky import ProcessPoolExecutor

    # The package has no type annotations. A worker that computes does not notice that its parent is gone.
    try:
        executor = ProcessPoolExecutor(max_workers=jobs, initializer=end_with_parent, initargs=(os.getpid(),))
    except (OSError, ImportError) as error:  # no semaphores: /dev/shm is missing or read-only
        raise _no_processes(error) from error
    try:
        yield Backend(executor, jobs)
    except BaseException as error:
        executor.shutdown(wait=False, kill_workers=True)
        if isinstance(error, OSError) and error.errno in _NO_MORE:
            raise _no_processes(error) from error
        raise
    executor.shutdown(wait=True)


def _no_processes(error: Exception) -> SlamInitError:
    return SlamInitError(f"this machine gives no further processes ({error}): use --backend sequential")


# -- a cluster -------------------------------------------------------------------------------------


@contextmanager
def _cluster(address: str, sources: Sequence[str]) -> Iterator[Backend]:
    """Connect to the scheduler of a Dask cluster, and check its workers.

    * ``address``: ``HOST:PORT``, ``tcp://HOST:PORT``, or ``tls://HOST:PORT`` with the certificates in Dask's
      configuration (``distributed.comm.tls``).
    """
    if not _ADDRESS.fullmatch(address):
        raise ConfigError(f"{address[:80]!r} is no address of a scheduler: give dask:HOST:PORT or dask:tls://HOST:PORT")
    try:
        distributed: Any = import_module("distributed")  # the package has no type annotations
    except ImportError:
        raise ConfigError("the backend dask needs the package distributed: pip install '.[dask]'") from None
    _check_certificates(distributed, address)
    # Dask logs each failure with a traceback; the error that is raised tells it in one line.
    logged = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        try:
            client = distributed.Client(address, timeout=_CONNECT, set_as_default=False)
        except Exception as error:  # a server of another protocol or version may cause any
            cause = " ".join(str(error).split()) or type(error).__name__
            raise SlamInitError(f"no Dask scheduler answers at {address}: {cause}"[:300]) from None
        try:
            _check_workers(client, address, sources)
            # pure=False: Dask must not reuse the answer of an earlier call with equal arguments.
            yield _Cluster(client, client.get_executor(pure=False), address)
        finally:
            client.close(timeout=_POLL_S)
    finally:
        logging.disable(logged)


class _Cluster(Backend):
    """The workers of a cluster, whose number may change; a lost cluster is an error."""

    largest_batch = _LARGEST_BATCH

    def __init__(self, client: Any, executor: Any, address: str) -> None:
        super().__init__(executor, sum(client.nthreads().values()))
        self._client = client
        self._address = address
        self._looked = self._seen = time.monotonic()

    def run(self, function: Callable[[_Task], _Answer], tasks: Iterable[_Task]) -> Iterator[tuple[_Task, _Answer]]:
        try:
            yield from super().run(function, tasks)
        except (CancelledError, OSError, TimeoutError) as error:
            raise _lost(f"the Dask scheduler at {self._address} was lost", error) from None
        except RuntimeError as error:  # KilledWorker; a closed client
            raise _lost(f"the Dask cluster at {self._address} gave a trial up", error) from None

    def _next(self, ended: SimpleQueue[Future[Any]]) -> Future[Any]:
        self._seen = time.monotonic()
        while True:
            self._count_workers()
            try:
                return ended.get(timeout=_POLL_S)
            except Empty:
                continue

    def _count_workers(self) -> None:
        """Look at the number of workers now and then: a cluster grows and shrinks."""
        now = time.monotonic()
        if now - self._looked < _POLL_S:
            return
        self._looked = now
        found = sum(self._client.nthreads().values())
        if found:
            self.workers, self._seen = found, now
        elif now - self._seen > _WITHOUT_WORKERS_S:
            raise _lost(f"the Dask scheduler at {self._address} has lost its workers", None)


def _lost(what: str, error: BaseException | None) -> SlamInitError:
    cause = "" if error is None or not str(error) else f" ({' '.join(str(error).split())[:200]})"
    return SlamInitError(f"{what}{cause}: completed trials are kept; start it again, and repeat the command")


def _check_certificates(distributed: Any, address: str) -> None:
    """Refuse a TLS address without certificates: Dask finds them in its configuration."""
    if not address.startswith("tls://"):
        return
    try:
        context = distributed.Security().get_connection_args("client").get("ssl_context")
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"the TLS files of Dask's configuration cannot be used: {error}"[:300]) from None
    if context is None:
        keys = "distributed.comm.tls.ca-file, .client.cert and .client.key"
        raise ConfigError(f"{address} needs certificates: name them in Dask's configuration ({keys})")


def worker_facts(sources: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """Tell the versions that a worker has, and the sources that do not exist there."""
    return _versions(), [text for text in sources if not os.path.lexists(text)]


def _versions() -> dict[str, str]:
    """Versions of the packages that have to be equal, because tasks are pickled; of Python without the patch level."""
    versions = {package: metadata.version(package) for package in ("slam-init", "distributed")}
    return versions | {"python": ".".join(platform.python_version_tuple()[:2])}


def _check_workers(client: Any, address: str, sources: Sequence[str]) -> None:
    """Raise an error if trials cannot run on the workers of a cluster."""
    if not client.nthreads():
        raise SlamInitError(f"the Dask scheduler at {address} has no workers: start at least one")
    for worker, facts in client.run(worker_facts, list(sources), on_error="return").items():
        if isinstance(facts, BaseException):
            cause = " ".join(str(facts).split())[:200]
            raise SlamInitError(f"the Dask worker {worker} cannot run slam-init ({cause}): install slam-init there")
        theirs, missing = facts
        for package, version in _versions().items():
            if theirs[package] != version:
                raise SlamInitError(
                    f"the Dask worker {worker} has {package} {theirs[package]}, and this machine {version}: install "
                    "the same version"
                )
        if missing:
            raise SlamInitError(
                f"the Dask worker {worker} lacks {missing[0]}: workers need the data under the same path"
            )
