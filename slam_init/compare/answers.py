"""The answers to requests, in the process in which trials run."""

from __future__ import annotations

import atexit
import os
import resource
import shutil
import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from slam_init.compare.messages import (
    Answer,
    MethodAnswer,
    MethodRequest,
    Request,
    TracksAnswer,
    TracksRequest,
    TrialAnswer,
    TrialRequest,
    answer_line,
)
from slam_init.compare.replay import find_tracks, replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.compare.trials import Settings, error_row, run_trial
from slam_init.errors import OutputError, SlamInitError
from slam_init.methods.external_command import is_external


def answer_to(request: Request) -> Answer:
    """Do what a request asks for."""
    if isinstance(request, MethodRequest):
        return _method(request)
    _create_tracks_folder(request.settings)
    return _trial(request) if isinstance(request, TrialRequest) else _tracks(request)


def load_libraries() -> None:
    """Import the libraries of the trials before the limit of memory is set and before the first trial is timed."""
    import cv2

    for library in ("gtsam", "slam_init.methods", "slam_init.initializer"):
        import_module(library)
    cv2.setNumThreads(1)


def _method(request: MethodRequest) -> MethodAnswer:
    from slam_init.methods import make_two_view

    try:
        make_two_view(request.name)
    except SlamInitError as error:
        return MethodAnswer(str(error))
    return MethodAnswer(None)


def _trial(request: TrialRequest) -> TrialAnswer:
    trial, settings = request.trial, request.settings
    exhausted = False
    _reset_peak_memory()
    try:
        row = run_trial(trial, settings)
        answer_line(TrialAnswer(row, exhausted))  # figures that are not finite raise a ValueError
    except MemoryError:
        exhausted = True
        row = error_row(trial, settings, _memory_message(settings))
    except OutputError as error:
        return TrialAnswer(error_row(trial, settings, str(error)), exhausted, str(error))
    except SlamInitError as error:
        row = error_row(trial, settings, str(error))
    except Exception as error:  # raised by the method: the trial counts as an error, and the row holds the message
        exhausted = _is_out_of_memory(error)
        cause = f"{type(error).__name__}: {error}"
        row = error_row(trial, settings, _memory_message(settings) if exhausted else cause)
    if not is_external(trial.method):  # the memory of this process is not that of an external program
        row = replace(row, peak_memory_mb=_peak_memory_mb())
    return TrialAnswer(row, exhausted)


def _tracks(request: TracksRequest) -> TracksAnswer:
    begin = time.perf_counter()
    failure: str | None = None
    digest = ""
    try:
        source = open_compared(request.text)
        find_tracks(source, request.text, Path(request.settings.tracks))
        digest = tracks_digest(source, replay(source, request.text, 0, Path(request.settings.tracks)))
    except SlamInitError as error:
        failure = str(error)
    except OSError as error:
        failure = f"cannot write the tracks of {request.text} ({error.strerror or error}): make room"
    return TracksAnswer(failure, 1e3 * (time.perf_counter() - begin), digest)


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
        atexit.register(_remove, folder)


def _remove(folder: Path) -> None:
    """Remove a folder that others may read: it disappears at once, so that they make it anew and find no part of it."""
    removed = folder.with_name(f"{folder.name}-{os.getpid()}")
    try:
        folder.rename(removed)
    except OSError:
        return
    shutil.rmtree(removed, ignore_errors=True)
