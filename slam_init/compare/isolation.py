"""Runs trials in a separate process, so that a method that hangs, crashes or exhausts memory spoils only its own trial.

Each worker of a backend keeps one such process and sends it one trial after the other. A process that does not answer
in time, or that dies, is replaced. The process sets the limit of memory on itself, so that allocations beyond the limit
fail in that process. The program of the process is :mod:`slam_init.compare.worker`.
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
from typing import TypeVar

from slam_init.compare.messages import Answer, Request, TracksAnswer, TracksRequest, TrialAnswer, TrialRequest
from slam_init.compare.rows import TrialRow
from slam_init.compare.trials import Settings, Trial, error_row
from slam_init.errors import SlamInitError

__all__ = ["TrialProcess", "isolated_tracks", "isolated_trial"]

#: Time for loading the libraries on a busy machine.
_START_S = 120.0
#: Time for tracking a sequence: enough for an hour of video at 30 frames per second.
_TRACKING_S = 3 * 3600.0

_local = threading.local()

_Answer = TypeVar("_Answer", TrialAnswer, TracksAnswer)


def isolated_trial(trial: Trial, settings: Settings) -> TrialRow:
    """Run a trial in the process of this thread.

    Parameters
    ----------
    trial : Trial
    settings : Settings
        With the limits of time and memory.

    Returns
    -------
    TrialRow
        Errors of any kind, missed limits and crashes give a row with the outcome ``error``.
    """
    process = _process(settings)
    failed_row = error_row(trial, settings, "")
    try:
        answer = process.ask(TrialRequest(trial, settings), TrialAnswer, settings.time_limit_s)
    except TimeoutError:
        _discard()
        return replace(failed_row, reason=f"no answer within {settings.time_limit_s:g} s")
    except EOFError:
        code = process.exit_code()
        _discard()
        return replace(failed_row, reason=f"the process died ({_exit_text(code)})")
    if answer.memory_exhausted:
        # After a failed allocation the state of the libraries is unknown.
        _discard()
    return answer.row


def isolated_tracks(text: str, settings: Settings) -> float:
    """Compute and store the tracks of a source in the process of this thread.

    Parameters
    ----------
    text : str
        Argument of :func:`slam_init.compare.sources.open_compared`.
    settings : Settings
        With the folder of the tracks.

    Returns
    -------
    float
        Duration in milliseconds.

    Raises
    ------
    SlamInitError
        If the source cannot be read to its end, or the process dies.
    """
    process = _process(replace(settings, memory_limit_mb=0))
    try:
        answer = process.ask(TracksRequest(text, settings), TracksAnswer, _TRACKING_S)
    except (TimeoutError, EOFError):
        _discard()
        raise SlamInitError(f"{text}: the tracking process died: run slam-init run on this source to see why") from None
    if answer.error is not None:
        raise SlamInitError(answer.error)
    return answer.tracking_ms


def _process(settings: Settings) -> TrialProcess:
    """Return the process of this thread; start one if there is none with this limit of memory."""
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


def _exit_text(code: int | None) -> str:
    import signal

    if code is not None and code < 0:
        with suppress(ValueError):
            return signal.Signals(-code).name
    return f"exit code {code}"


class TrialProcess:
    """A new interpreter that answers requests, one at a time.

    The process is started with :mod:`subprocess`. Daemon processes of :mod:`multiprocessing` cannot have children, and
    some backends run in such processes. The process exits when the connection is closed, however its parent ends.

    Parameters
    ----------
    memory_limit_mb : int
        Limit of the address space, in addition to the address space that the libraries take; 0 for no limit.
    """

    def __init__(self, memory_limit_mb: int) -> None:
        self.memory_limit_mb = memory_limit_mb
        self._connection: Connection[Request, Answer | str]
        self._connection, theirs = Pipe()
        command = [sys.executable, "-m", "slam_init.compare.worker", str(theirs.fileno()), str(memory_limit_mb)]
        # One core for each trial. The process can import all modules that its parent can import.
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        theirs.close()
        self._ready = False

    def ask(self, request: Request, kind: type[_Answer], limit_s: float) -> _Answer:
        """Send a request and wait for the answer.

        Parameters
        ----------
        request : TrialRequest or TracksRequest
        kind : type
            Class of the answer to such a request: TrialAnswer or TracksAnswer.
        limit_s : float
            Longest time to wait for the answer; the time in which the process loads its libraries is not counted.

        Returns
        -------
        TrialAnswer or TracksAnswer
            An object of the class ``kind``.

        Raises
        ------
        TimeoutError
            If the answer does not arrive in time.
        EOFError
            If the process is gone, or if its answer is of another class.
        """
        try:
            if not self._ready:
                _receive(self._connection, _START_S)
                self._ready = True
            self._connection.send(request)
            answer = _receive(self._connection, limit_s)
        except TimeoutError:  # TimeoutError is a subclass of OSError
            raise
        except OSError as error:
            raise EOFError(str(error)) from error
        if not isinstance(answer, kind):
            raise EOFError(f"unexpected answer {answer!r}")
        return answer

    def exit_code(self) -> int | None:
        """Return the exit code of a process that is gone.

        Returns
        -------
        int or None
            Negative number of a signal if a signal ended the process; None if the process is still running after 5 s.
        """
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout=5.0)
        return None

    def kill(self) -> None:
        """End the process at once."""
        self._connection.close()
        self._process.kill()
        self._process.wait()


def _receive(connection: Connection[Request, Answer | str], limit_s: float) -> Answer | str:
    if not connection.poll(limit_s):
        raise TimeoutError
    return connection.recv()
