"""Each trial runs in a process of its own kind: a method that hangs, crashes or eats memory costs its own trial only.

A worker (of any backend) keeps one such process and sends it trial after trial; a process that does not answer in time,
or dies, is replaced. The limit of memory is set by the process on itself, so that an allocation beyond it fails there.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from slam_init.compare.trials import Settings, Trial, error_row
from slam_init.errors import SlamInitError

__all__ = ["TrialProcess", "isolated_tracks", "isolated_trial"]

#: To load the libraries on a busy machine.
_START_S = 120.0
#: Tracks of a sequence: an hour of video at 30 frames a second.
_TRACKING_S = 3 * 3600.0

_local = threading.local()


def isolated_trial(trial: Trial, settings: Settings) -> dict[str, Any]:
    """The row of a trial; an error of any kind is a row too."""
    process = _process(settings)
    begin_row = error_row(trial, settings, "")
    try:
        answer = process.ask(("trial", trial, settings), settings.time_limit_s)
    except TimeoutError:
        _discard()
        return begin_row | {"reason": f"no answer within {settings.time_limit_s:g} s"}
    except EOFError:
        code = process.exit_code()
        _discard()
        return begin_row | {"reason": f"the process died ({_named(code)})"}
    if answer["memory_exhausted"]:
        # What an allocation that failed left behind is not to be trusted.
        _discard()
    row: dict[str, Any] = answer["row"]
    return row


def isolated_tracks(text: str, settings: Settings) -> float:
    """Find and store the tracks of a source; how long it took in milliseconds.

    Raises
    ------
    SlamInitError
        Where the source cannot be read to its end.
    """
    process = _process(replace(settings, memory_limit_mb=0))
    try:
        answer = process.ask(("tracks", text, settings), _TRACKING_S)
    except (TimeoutError, EOFError):
        _discard()
        raise SlamInitError(f"{text}: the process that finds its tracks died: look at the source alone") from None
    if answer["error"] is not None:
        raise SlamInitError(str(answer["error"]))
    return float(answer["tracking_ms"])


def _process(settings: Settings) -> TrialProcess:
    """The process of this thread, started where there is none with these limits."""
    process: TrialProcess | None = getattr(_local, "process", None)
    if process is None or process.memory_limit_mb != settings.memory_limit_mb:
        _discard()
        process = _local.process = TrialProcess(settings.memory_limit_mb)
    return process


def _discard() -> None:
    process: TrialProcess | None = getattr(_local, "process", None)
    if process is not None:
        process.kill()
    _local.process = None


def _named(code: int | None) -> str:
    import signal

    if code is not None and code < 0:
        with suppress(ValueError):
            return signal.Signals(-code).name
    return f"exit code {code}"


class TrialProcess:
    """A fresh interpreter that answers requests, one at a time.

    Started by hand and not by :mod:`multiprocessing`, whose children may have no children, which would exclude some
    backends; it ends when the connection is closed, by whatever end of its parent.

    Parameters
    ----------
    memory_limit_mb : int
        Of its address space beyond what the libraries take; 0 for none.
    """

    def __init__(self, memory_limit_mb: int) -> None:
        self.memory_limit_mb = memory_limit_mb
        self._connection, theirs = Pipe()
        command = [sys.executable, "-m", "slam_init.compare.worker", str(theirs.fileno()), str(memory_limit_mb)]
        # One trial, one core; what the parent can import, the child can.
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        theirs.close()
        self._ready = False

    def ask(self, request: tuple[Any, ...], limit_s: float) -> dict[str, Any]:
        """The answer to a request.

        Raises
        ------
        TimeoutError
            Where it does not come in time.
        EOFError
            Where the process is gone.
        """
        try:
            if not self._ready:
                _receive(self._connection, _START_S)
                self._ready = True
            self._connection.send(request)
            answer: dict[str, Any] = _receive(self._connection, limit_s)
        except TimeoutError:  # an OSError too
            raise
        except OSError as error:
            raise EOFError(str(error)) from error
        return answer

    def exit_code(self) -> int | None:
        """Of a process that is gone."""
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout=5.0)
        return None

    def kill(self) -> None:
        """End it, whatever it does."""
        self._connection.close()
        self._process.kill()
        self._process.wait()


def _receive(connection: Connection[Any, Any], limit_s: float) -> Any:
    if not connection.poll(limit_s):
        raise TimeoutError
    return connection.recv()
