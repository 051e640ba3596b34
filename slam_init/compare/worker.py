"""The program of the process in which trials run: it reads requests and answers each of them.

:mod:`slam_init.compare.isolation` starts the process.
"""

from __future__ import annotations

import atexit
import os
import resource
import shutil
import sys
import threading
import time
from dataclasses import replace
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

from slam_init.compare.messages import READY, Answer, Request, TracksAnswer, TracksRequest, TrialAnswer, TrialRequest
from slam_init.compare.replay import find_tracks
from slam_init.compare.sources import open_compared
from slam_init.compare.trials import Settings, error_row, run_trial
from slam_init.errors import SlamInitError

__all__ = ["main"]

#: Interval at which the process checks that its parent still exists.
_PARENT_CHECK_S = 1.0


def main(arguments: list[str]) -> None:
    """Answer requests on an inherited connection until it is closed.

    Parameters
    ----------
    arguments : list of str
        File descriptor of the connection; limit of memory in MB, 0 for no limit.
    """
    descriptor, memory_limit_mb = (int(argument) for argument in arguments)
    connection: Connection[Answer | str, Request] = Connection(descriptor)
    threading.Thread(target=_exit_with_parent, args=(os.getppid(),), daemon=True).start()
    _load_libraries()
    if memory_limit_mb:
        _limit_memory(memory_limit_mb)
    connection.send(READY)
    while True:
        try:
            request = connection.recv()
        except EOFError:
            return
        _create_tracks_folder(request.settings)
        connection.send(_trial(request) if isinstance(request, TrialRequest) else _tracks(request))


def _exit_with_parent(parent: int) -> None:
    """Exit when the parent is gone. A method that hangs does not notice that the connection is closed."""
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_S)
    os._exit(1)


def _trial(request: TrialRequest) -> TrialAnswer:
    trial, settings = request.trial, request.settings
    exhausted = False
    _reset_peak_memory()
    try:
        row = run_trial(trial, settings)
    except MemoryError:
        exhausted = True
        row = error_row(trial, settings, _memory_message(settings))
    except SlamInitError as error:
        row = error_row(trial, settings, str(error))
    except Exception as error:  # raised by the method: the trial counts as an error, and the row holds the message
        exhausted = _is_out_of_memory(error)
        cause = f"{type(error).__name__}: {error}"
        row = error_row(trial, settings, _memory_message(settings) if exhausted else cause)
    return TrialAnswer(replace(row, peak_memory_mb=_peak_memory_mb()), exhausted)


def _tracks(request: TracksRequest) -> TracksAnswer:
    begin = time.perf_counter()
    failure: str | None = None
    try:
        find_tracks(open_compared(request.text), request.text, Path(request.settings.tracks))
    except SlamInitError as error:
        failure = str(error)
    return TracksAnswer(failure, 1e3 * (time.perf_counter() - begin))


def _load_libraries() -> None:
    """Import the libraries of the trials before the limit of memory is set and before the first trial is timed."""
    import cv2

    for library in ("gtsam", "slam_init.methods", "slam_init.initializer"):
        import_module(library)
    cv2.setNumThreads(1)


def _limit_memory(limit_mb: int) -> None:
    """Let allocations beyond the limit fail.

    The address space that is in use now is added to the limit: libraries reserve address space that they never use.
    """
    in_use = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if _linux() else 0
    limit = in_use + limit_mb * 2**20
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def _reset_peak_memory() -> None:
    """Reset the peak memory that the kernel counts for this process, so that the next reading is that of the trial."""
    if _linux():
        Path("/proc/self/clear_refs").write_text("5")


def _peak_memory_mb() -> float:
    if _linux():
        line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
        return round(int(line.split()[1]) / 1024, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 1)  # macOS: in bytes, over all trials


def _linux() -> bool:
    return sys.platform == "linux"


def _memory_message(settings: Settings) -> str:
    return f"more than {settings.memory_limit_mb} MB of memory"


def _is_out_of_memory(error: Exception) -> bool:
    """Return whether an error means that memory ran out. OpenCV and C++ extensions do not raise MemoryError."""
    text = str(error)
    return "Insufficient memory" in text or "bad_alloc" in text


def _create_tracks_folder(settings: Settings) -> None:
    """Create the folder of the tracks on a machine that does not share it, and remove it at exit."""
    folder = Path(settings.tracks)
    if settings.tracks and not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        atexit.register(shutil.rmtree, folder, ignore_errors=True)


if __name__ == "__main__":
    main(sys.argv[1:])
