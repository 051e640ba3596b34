"""The process in which trials run; see :mod:`slam_init.compare.isolation`. Reads requests, answers each."""

from __future__ import annotations

import atexit
import os
import resource
import shutil
import sys
import threading
import time
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from slam_init.compare.replay import find_tracks
from slam_init.compare.sources import open_compared
from slam_init.compare.trials import Settings, Trial, error_row, run_trial
from slam_init.errors import SlamInitError

__all__ = ["main"]

_LOOK_AFTER_PARENT_S = 1.0


def main(arguments: list[str]) -> None:
    """Answer requests on an inherited connection until it is closed."""
    descriptor, memory_limit_mb = (int(argument) for argument in arguments)
    connection: Connection[Any, Any] = Connection(descriptor)
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    _load()
    if memory_limit_mb:
        _limit_memory(memory_limit_mb)
    connection.send("ready")
    while True:
        try:
            kind, what, settings = connection.recv()
        except EOFError:
            return
        _own_tracks_folder(settings)
        connection.send(_trial(what, settings) if kind == "trial" else _tracks(what, settings))


def _end_with_parent(parent: int) -> None:
    """A method that hangs does not see that the connection is closed: end it when the parent is gone."""
    while os.getppid() == parent:
        time.sleep(_LOOK_AFTER_PARENT_S)
    os._exit(1)


def _trial(trial: Trial, settings: Settings) -> dict[str, Any]:
    exhausted = False
    _forget_peak()
    try:
        row = run_trial(trial, settings)
    except MemoryError:
        exhausted = True
        row = error_row(trial, settings, _too_much(settings))
    except SlamInitError as error:
        row = error_row(trial, settings, str(error))
    except Exception as error:  # a method's own: it costs the trial, and the row says so
        exhausted = _is_out_of_memory(error)
        cause = f"{type(error).__name__}: {error}"
        row = error_row(trial, settings, _too_much(settings) if exhausted else cause)
    return {"row": row | {"peak_memory_mb": _peak_mb()}, "memory_exhausted": exhausted}


def _tracks(text: str, settings: Settings) -> dict[str, Any]:
    begin = time.perf_counter()
    try:
        find_tracks(open_compared(text), text, Path(settings.tracks))
    except SlamInitError as error:
        return {"error": str(error), "tracking_ms": None}
    return {"error": None, "tracking_ms": 1e3 * (time.perf_counter() - begin)}


def _load() -> None:
    """Load what trials need, before the limit of memory is set and the first one is timed."""
    import cv2

    for library in ("gtsam", "slam_init.methods", "slam_init.initializer"):
        import_module(library)
    cv2.setNumThreads(1)


def _limit_memory(limit_mb: int) -> None:
    """Let allocations fail beyond the limit; libraries reserve address space that they never touch, which is added."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if _linux() else 0
    limit = taken + limit_mb * 2**20
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def _forget_peak() -> None:
    """Start the kernel's count of the peak again, so that it is the trial's."""
    if _linux():
        Path("/proc/self/clear_refs").write_text("5")


def _peak_mb() -> float:
    if _linux():
        line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
        return round(int(line.split()[1]) / 1024, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 1)  # elsewhere in bytes, of all trials


def _linux() -> bool:
    return sys.platform == "linux"


def _too_much(settings: Settings) -> str:
    return f"more than {settings.memory_limit_mb} MB of memory"


def _is_out_of_memory(error: Exception) -> bool:
    """OpenCV and C++ extensions report it in errors of their own."""
    text = str(error)
    return "Insufficient memory" in text or "bad_alloc" in text


def _own_tracks_folder(settings: Settings) -> None:
    """On a machine that does not share the folder of the tracks this process makes one, and takes it away again."""
    folder = Path(settings.tracks)
    if settings.tracks and not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        atexit.register(shutil.rmtree, folder, ignore_errors=True)


if __name__ == "__main__":
    main(sys.argv[1:])
