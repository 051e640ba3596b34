"""Backends that run trials: sequentially in this process, on the cores of this machine (loky), or on a Dask cluster.

All three backends call the same function with the same arguments, so they give the same results. They submit only a few
trials at a time, so memory does not grow with the number of trials.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from slam_init.compare.backend import Backend
from slam_init.errors import ConfigError, SlamInitError
from slam_init.system.process_guard import end_with_parent

__all__ = ["DASK", "Backend", "open_backend"]

DASK = "dask:"

#: No further file, process, memory or place may be had.
_NO_MORE = (errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM, errno.ENOSPC, errno.EROFS, errno.EACCES)


@contextmanager
def open_backend(name: str, jobs: int, sources: Sequence[str] = ()) -> Iterator[Backend]:
    """Open a backend by name.

    * ``name``: ``loky``, ``sequential`` or ``dask:ADDRESS``, with the address of a Dask scheduler.
    * ``jobs``: Number of processes of loky; the other backends do not use it.
    """
    if name == "sequential":
        yield Backend(None, 1)
    elif name == "loky":
        with _loky(jobs) as backend:
            yield backend
    elif name.startswith(DASK) and name != DASK:
        from slam_init.compare.dask_cluster import open_cluster

        with open_cluster(name.removeprefix(DASK), sources) as backend:
            yield backend
    else:
        raise ConfigError(f"unknown backend {name!r}: use loky, sequential or dask:ADDRESS")


def _no_processes(error: Exception) -> SlamInitError:
    return SlamInitError(f"this machine gives no further processes ({error}): use --backend sequential")


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
