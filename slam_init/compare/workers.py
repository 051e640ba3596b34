"""Where trials run: in processes of this machine, or on the workers of a Dask cluster, which start such a process each.

A method that hangs, crashes or exhausts memory spoils only its own trial, because pebble ends and replaces the process.
After a third-party method (``package.module:attribute``) the process is replaced as well: the method may have
changed the libraries, or left threads. The processes end when the comparison ends, whatever ends it.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar

from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.rows import TrialRow
from slam_init.compare.sources import ComparedSource, open_compared
from slam_init.compare.trials import Settings, Trial, error_row, run_trial
from slam_init.errors import SlamInitError, place_of
from slam_init.methods.external_command import is_external
from slam_init.output.folder import writing

DASK = "dask:"
#: Time for tracking a sequence: enough for an hour of video at 30 frames per second.
_TRACKING_S = 3 * 3600.0
#: Time for writing the frames of an external program, beyond its own time limit.
_WRITING_S = 120.0
#: The kernel sends a signal when the parent ends.
_PR_SET_PDEATHSIG = 1
#: Of this process, on Linux: its memory, the file that resets its peak, and its address space.
_STATUS, _PEAK, _STATM = Path("/proc/self/status"), Path("/proc/self/clear_refs"), Path("/proc/self/statm")
#: Exit code of a process whose memory was exhausted. The state of its libraries is unknown then.
_EXHAUSTED = 99
#: A scheduler has to answer within this time.
_CONNECT = "10s"

_Task = TypeVar("_Task")


def run_trials(trials: Sequence[Trial], settings: Settings, jobs: int) -> Generator[TrialRow, None, None]:
    """Run trials in processes of this machine; yield their rows as they end.

    * ``settings``: With the folder of the tracks.
    * ``jobs``: Number of processes.
    * Returns: Errors of any kind, missed limits and crashes give rows with the outcome ``error``.
    """
    from pebble import ProcessExpired

    def limit_s(trial: Trial) -> float:
        # An external program has the limit for itself, and is killed by the process of its trial.
        return settings.time_limit_s + (_WRITING_S if is_external(trial.method) else 0.0)

    for theirs in (False, True):
        chosen = [trial for trial in trials if theirs == (":" in trial.method and not is_external(trial.method))]
        for trial, ended in _ended(_trial, chosen, settings, jobs, limit_s, max_tasks=int(theirs)):
            try:
                yield ended.result()
            except TimeoutError:
                yield error_row(trial, settings, f"no answer within {settings.time_limit_s:g} s")
            except ProcessExpired as expired:
                code = expired.exitcode
                died = f"the process died ({signal.Signals(-code).name if code < 0 else f'exit code {code}'})"
                exhausted = f"more than {settings.memory_limit_mb} MB of memory"
                yield error_row(trial, settings, exhausted if code == _EXHAUSTED else died)


def track_sources(sources: Sequence[ComparedSource], settings: Settings, jobs: int) -> Iterator[tuple[str, str]]:
    """Compute and store the tracks of sources; yield the label of each source and the digest of its tracks."""
    for source, ended in _ended(_tracks, sources, settings, jobs, lambda _: _TRACKING_S):
        if isinstance(ended.exception(), OSError):  # no answer in time, or pebble's ProcessExpired
            raise SlamInitError(f"{source.text}: the tracking process died: run slam-init run on it to see why")
        yield source.label, ended.result()


# -- a cluster -------------------------------------------------------------------------------------


def run_on_cluster(address: str, trials: Sequence[Trial], settings: Settings) -> Generator[TrialRow, None, None]:
    """Run trials on the workers of a Dask cluster; yield their rows as they end.

    * ``address``: Of the scheduler, as Dask takes it, with ``dask:`` or without: ``HOST:PORT``, or ``tls://HOST:PORT``
      with the certificates in Dask's configuration. The workers need slam-init, and the data under the same paths.
    """
    by_source = [list(of_source) for _, of_source in groupby(trials, key=lambda trial: trial.source.label)]
    try:
        distributed: Any = import_module("distributed")  # the package has no type annotations
        with distributed.Client(address.removeprefix(DASK), timeout=_CONNECT) as client:
            if not client.nthreads():
                raise RuntimeError("it has no workers: start at least one")
            # pure=False: Dask must not reuse the answer of an earlier call with equal arguments.
            for future in distributed.as_completed(client.map(_run_source, by_source, settings=settings, pure=False)):
                yield from future.result()
    except Exception as error:  # of Dask: a lost scheduler, a worker without the package, an address that is none
        cause = " ".join(str(error).split())[:300] or type(error).__name__
        raise SlamInitError(f"the Dask cluster at {address} failed: {cause}; completed trials are kept") from None


def _run_source(trials: Sequence[Trial], settings: Settings) -> list[TrialRow]:
    """Run the trials of one source on a worker of a cluster."""
    multiprocessing.current_process().daemon = False  # a worker of Dask may have no children otherwise
    with tempfile.TemporaryDirectory(prefix="slam-init-tracks-") as tracks:
        there = replace(settings, tracks=tracks)
        list(track_sources([trials[0].source], there, 1))
        return list(run_trials(trials, there, 1))


# -- the processes ---------------------------------------------------------------------------------


def _ended(
    function: Callable[[_Task, Settings], Any],
    tasks: Iterable[_Task],
    settings: Settings,
    jobs: int,
    limit_s: Callable[[_Task], float],
    max_tasks: int = 0,
) -> Iterator[tuple[_Task, Future[Any]]]:
    """Call a function in processes; yield each task with its future when the future is done.

    * ``limit_s``: Time limit of a task. The time in which a process loads its libraries is not counted.
    * ``max_tasks``: A process is replaced after this number of tasks; 0 for never.
    """
    from pebble import ProcessPool

    # A forked process would inherit the threads of OpenCV, numba and tqdm as locks that nobody opens.
    context = multiprocessing.get_context("spawn")
    pool: Any = ProcessPool(jobs, max_tasks, _prepare, (os.getpid(),), context)
    try:
        futures = {pool.schedule(function, (task, settings), timeout=limit_s(task)): task for task in tasks}
        for future in as_completed(futures):
            if isinstance(error := future.exception(), BrokenProcessPool):
                raise error
            yield futures.pop(future), future
    except (BrokenProcessPool, RuntimeError, OSError) as error:
        raise SlamInitError(f"the processes of the trials cannot run ({error or type(error).__name__})") from error
    finally:
        pool.stop()
        pool.join()


def _prepare(parent: int) -> None:
    """Prepare a process: no output, one thread for each library, the libraries loaded, and an end with its parent."""
    for stream in range(3):
        os.dup2(os.open(os.devnull, os.O_RDWR), stream)
    if sys.platform == "linux":  # elsewhere a process ends after the trial that it runs
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)
    import cv2
    from threadpoolctl import threadpool_limits

    for library in ("gtsam", "slam_init.methods", "slam_init.initializer"):
        import_module(library)
    cv2.setNumThreads(1)
    threadpool_limits(1)
    os.environ["OMP_NUM_THREADS"] = "1"  # of external programs


def _trial(trial: Trial, settings: Settings) -> TrialRow:
    """Run a trial in a process of its own."""
    if _PEAK.exists():  # the next reading of the peak memory is that of the trial
        _PEAK.write_text("5")
    _limit_memory(settings.memory_limit_mb)
    tempfile.tempdir = settings.tracks or None  # an external program may be killed before it removes its folder
    try:
        row = run_trial(trial, settings)
        row.text()  # figures that are not finite raise a ValueError
    except BaseException as error:  # raised by the method, sys.exit too: the trial counts as an error
        if isinstance(error, MemoryError) or "Insufficient memory" in str(error) or "bad_alloc" in str(error):
            os._exit(_EXHAUSTED)  # OpenCV and C++ extensions do not raise MemoryError
        text = str(error) if isinstance(error, SlamInitError) else f"{type(error).__name__}: {error}{place_of(error)}"
        row = error_row(trial, settings, text)
    # The memory of this process is not that of an external program.
    return row if is_external(trial.method) else replace(row, peak_memory_mb=_peak_memory_mb())


def _tracks(source: ComparedSource, settings: Settings) -> str:
    """Store the tracks of a source; return their digest."""
    opened = open_compared(source.text)
    with writing(f"the tracks of {source.text}"):
        return tracks_digest(opened, source.text, replay(opened, source.text, 0, settings.tracks))


def _limit_memory(limit_mb: int) -> None:
    """Let allocations beyond a limit fail; 0 for no limit.

    The address space that is in use now is added to the limit: libraries reserve address space that they never use.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    in_use = int(_STATM.read_text().split()[0]) * resource.getpagesize() if _STATM.exists() else 0
    limit = in_use + limit_mb * 2**20 if limit_mb else hard
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _peak_memory_mb() -> float:
    if _STATUS.exists():
        line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM"))
        return round(int(line.split()[1]) / 1024, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 1)  # macOS: in bytes, over all trials
