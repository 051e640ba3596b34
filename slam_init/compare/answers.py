"""The answers to requests, in the process in which trials run."""

from __future__ import annotations

import atexit
import os
import resource
import shutil
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from slam_init.compare.isolation import Answer, MethodRequest, Request, TracksRequest, TrialRequest
from slam_init.compare.replay import find_tracks, replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.compare.trials import Settings, error_row, run_trial
from slam_init.errors import OutputError, SlamInitError
from slam_init.methods.external_command import is_external


def answer_to(request: Request) -> Answer:
    """Do what a request asks for."""
    name = type(request).__name__
    if isinstance(request, MethodRequest):
        return Answer(name, _failure_of_method(request.name))
    _create_tracks_folder(request.settings)
    if isinstance(request, TracksRequest):
        digest, error = _tracks(request)
        return Answer(name, error, digest=digest)
    return _trial(request)


def load_libraries() -> None:
    """Import the libraries of the trials before the limit of memory is set and before the first trial is timed."""
    import cv2

    for library in ("gtsam", "slam_init.methods", "slam_init.initializer"):
        import_module(library)
    cv2.setNumThreads(1)


def _failure_of_method(name: str) -> str | None:
    from slam_init.methods import make_two_view

    try:
        make_two_view(name)
    except SlamInitError as error:
        return str(error)
    return None


def _trial(request: TrialRequest) -> Answer:
    trial, settings = request.trial, request.settings
    exhausted, unwritten = False, None
    _reset_peak_memory()
    try:
        row = run_trial(trial, settings)
        Answer("", row=row).line()  # figures that are not finite raise a ValueError
    except MemoryError:
        exhausted = True
        row = error_row(trial, settings, _memory_message(settings))
    except SlamInitError as error:
        row = error_row(trial, settings, str(error))
        unwritten = str(error) if isinstance(error, OutputError) else None
    except Exception as error:  # raised by the method: the trial counts as an error, and the row holds the message
        exhausted = _is_out_of_memory(error)
        cause = f"{type(error).__name__}: {error}"
        row = error_row(trial, settings, _memory_message(settings) if exhausted else cause)
    if not is_external(trial.method):  # the memory of this process is not that of an external program
        row = replace(row, peak_memory_mb=_peak_memory_mb())
    return Answer(type(request).__name__, unwritten, row, exhausted)


def _tracks(request: TracksRequest) -> tuple[str, str | None]:
    """Store the tracks of a source; return their digest, or why the source cannot be read."""
    tracks = Path(request.settings.tracks)
    try:
        source = open_compared(request.text)
        find_tracks(source, request.text, tracks)
        return tracks_digest(source, replay(source, request.text, 0, tracks)), None
    except SlamInitError as error:
        return "", str(error)
    except OSError as error:
        return "", f"cannot write the tracks of {request.text} ({error.strerror or error}): make room"


def _reset_peak_memory() -> None:
    """Reset the peak memory that the kernel counts for this process, so that the next reading is that of the trial."""
    if sys.platform == "linux":
        Path("/proc/self/clear_refs").write_text("5")


def _peak_memory_mb() -> float:
    if sys.platform == "linux":
        line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
        return round(int(line.split()[1]) / 1024, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 1)  # macOS: in bytes, over all trials


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
