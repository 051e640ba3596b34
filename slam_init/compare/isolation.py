"""Runs trials in a separate process, so that a method that hangs, crashes or exhausts memory spoils only its own trial.

Each worker of a backend keeps one such process and sends it one trial after the other. A process that does not answer
in time, or that dies, is replaced. So is a process in which a method of somebody else (``package.module:attribute``)
has run: the method may have changed the libraries, or left threads. The process sets the limit of memory on itself, so
that allocations beyond the limit fail in that process. The program of the process is :mod:`slam_init.compare.worker`.

A pool of loky has no time limit for a task, and loses all its open tasks when a worker dies. A pool of pebble unpickles
what a method of somebody else sends. So the backends run such a process for each of their workers.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from slam_init.compare.rows import TrialRow, checked_row
from slam_init.compare.trials import Settings, Trial, error_row
from slam_init.errors import ConfigError, OutputError, SlamInitError
from slam_init.methods.external_command import is_external
from slam_init.methods.external_run import USER_PYTHONPATH
from slam_init.output.plain_json import parsed

#: Sent by the process when it has loaded its libraries, before the first request.
READY = b"ready\n"
#: Longest text of an error in characters.
_MAX_TEXT = 2000


@dataclass(frozen=True)
class TrialRequest:
    """Run a trial."""

    trial: Trial
    settings: Settings


@dataclass(frozen=True)
class TracksRequest:
    """Compute and store the tracks of a source."""

    #: Argument of :func:`slam_init.compare.sources.open_compared`.
    text: str
    #: With the folder of the tracks.
    settings: Settings


@dataclass(frozen=True)
class MethodRequest:
    """Import and make a method."""

    #: ``package.module:attribute``.
    name: str


@dataclass(frozen=True)
class Answer:
    """The answer to a request."""

    #: Name of the class of the request.
    request: str
    #: Why a file of a trial cannot be written, a source cannot be read to its end, or a method cannot be made.
    error: str | None = None
    #: The row of a trial. If a file of the trial could not be written, the row says nothing about the method.
    row: TrialRow | None = None
    #: Whether an allocation of a trial failed. The state of the libraries in the process is unknown then.
    memory_exhausted: bool = False
    #: :func:`slam_init.compare.replay.tracks_digest` of the tracks.
    digest: str = ""

    def line(self) -> bytes:
        """Write the answer as one line. A row with a number that is not finite is a ValueError."""
        return json.dumps(asdict(self), allow_nan=False).encode() + b"\n"

    @staticmethod
    def parse(line: bytes) -> Answer:
        """Read an answer, and check each of its values."""
        answer = parsed(Answer, line)
        if answer.row is not None:
            checked_row(answer.row)
        return answer if answer.error is None else replace(answer, error=" ".join(answer.error.split())[:_MAX_TEXT])


Request = TrialRequest | TracksRequest | MethodRequest


#: Time for loading the libraries on a busy machine.
_START_S = 120.0
#: Time for tracking a sequence: enough for an hour of video at 30 frames per second.
_TRACKING_S = 3 * 3600.0

#: Time for importing and making a method.
_METHOD_S = 60.0
#: Time for writing the frames of an external program, beyond its own time limit.
_WRITING_S = 120.0
#: Longest answer: a row with its texts has less than 10 kB.
_MAX_ANSWER_BYTES = 1 << 20

_local = threading.local()


def isolated_trial(trial: Trial, settings: Settings) -> TrialRow:
    """Run a trial in the process of this thread.

    * Returns: Errors of any kind, missed limits and crashes give a row with the outcome ``error``.
    """
    process = _process(settings)
    failed_row = error_row(trial, settings, "")
    try:
        answer = process.ask(TrialRequest(trial, settings), _limit_s(trial, settings))
    except TimeoutError:
        end_process()
        return replace(failed_row, reason=f"no answer within {settings.time_limit_s:g} s")
    except EOFError as error:
        code = process.exit_code()
        end_process()
        return replace(failed_row, reason=str(error) or f"the process {_end_text(code)}")
    if answer.memory_exhausted or (":" in trial.method and not is_external(trial.method)):
        # After a failed allocation, or a method of somebody else, the state of the libraries is unknown.
        end_process()
    if answer.error is not None and (settings.recordings or settings.trajectories) is not None:
        raise OutputError(answer.error)
    if answer.row is None or _of_trial(answer.row) != _of_trial(failed_row):
        return replace(failed_row, reason="the answer is that of another trial")
    return answer.row


def isolated_trials(trials: Sequence[Trial], settings: Settings) -> list[TrialRow]:
    """Run trials one after the other in the process of this thread."""
    return [isolated_trial(trial, settings) for trial in trials]


def _limit_s(trial: Trial, settings: Settings) -> float:
    """The time limit of a trial. An external program has the limit for itself, and is killed by this process."""
    return settings.time_limit_s + (_WRITING_S if is_external(trial.method) else 0.0)


def _of_trial(row: TrialRow) -> tuple[str | int | None, ...]:
    """Return the values of a row that are known before the trial."""
    return (*row.key, row.group, row.frames_limit, row.injected_cause, row.judged_by)


def isolated_tracks(text: str, settings: Settings) -> str:
    """Compute and store the tracks of a source in the process of this thread; return their digest."""
    process = _process(replace(settings, memory_limit_mb=0))
    try:
        answer = process.ask(TracksRequest(text, settings), _TRACKING_S)
    except (TimeoutError, EOFError):
        end_process()
        raise SlamInitError(f"{text}: the tracking process died: run slam-init run on this source to see why") from None
    if answer.error is not None:
        raise SlamInitError(answer.error)
    return answer.digest


def check_method(name: str) -> None:
    """Import and make a method in a process of its own."""
    process = TrialProcess(0)
    try:
        error = process.ask(MethodRequest(name), _METHOD_S).error
    except TimeoutError:
        error = f"the method {name!r} cannot be made: no answer within {_METHOD_S:g} s"
    except EOFError:
        error = f"the method {name!r} cannot be made: the process {_end_text(process.exit_code())}"
    finally:
        process.kill()
    if error is not None:
        raise ConfigError(error)


def _process(settings: Settings) -> TrialProcess:
    """Return the process of this thread; start one if there is none with this limit of memory."""
    process: TrialProcess | None = getattr(_local, "process", None)
    if process is None or process.memory_limit_mb != settings.memory_limit_mb:
        end_process()
        process = _local.process = TrialProcess(settings.memory_limit_mb)
    return process


def end_process() -> None:
    """End the process of this thread, if there is one."""
    process: TrialProcess | None = getattr(_local, "process", None)
    if process is not None:
        process.kill()
    _local.process = None


def _end_text(code: int | None) -> str:
    if code is None:
        return "closed its connection"
    if code < 0:
        with suppress(ValueError):
            return f"died ({signal.Signals(-code).name})"
    return f"died (exit code {code})"


class TrialProcess:
    """A new interpreter that answers requests, one at a time.

    The process is started with :mod:`subprocess`. Daemon processes of :mod:`multiprocessing` cannot have children, and
    some backends run in such processes. The process leads a group of its own. The group is killed when the connection
    is closed or the parent ends (:mod:`slam_init.system.process_guard`).

    * ``memory_limit_mb``: Limit of the address space, in addition to the address space that the libraries take; 0 for
      no limit.
    """

    def __init__(self, memory_limit_mb: int) -> None:
        self.memory_limit_mb = memory_limit_mb
        self._connection: Connection[Request, bytes]
        self._connection, theirs = Pipe()
        command = [sys.executable, "-m", "slam_init.compare.worker"]
        command += [str(number) for number in (theirs.fileno(), memory_limit_mb, os.getpid())]
        # One core for each trial. The process can import all modules that its parent can import.
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment.setdefault(USER_PYTHONPATH, os.environ.get("PYTHONPATH", ""))
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        theirs.close()
        self._ready = False
        self._rest = b""

    def ask(self, request: Request, limit_s: float) -> Answer:
        """Send a request and wait for the answer.

        * ``limit_s``: The time in which the process loads its libraries is not counted.
        """
        try:
            if not self._ready:
                self._ready = self._line(_START_S) == READY
            self._connection.send(request)
            answer = Answer.parse(self._line(limit_s))
        except TimeoutError:  # TimeoutError is a subclass of OSError
            raise
        except OSError:
            raise EOFError from None
        except ValueError as error:
            raise EOFError(f"not an answer: {error}"[:200]) from None
        if answer.request != type(request).__name__:
            raise EOFError(f"not the answer to {type(request).__name__}")
        return answer

    def exit_code(self) -> int | None:
        """Return the exit code of a process that is gone.

        * Returns: Negative number of a signal if a signal ended the process; None if the process is still running after
          5 s.
        """
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout=5.0)
        return None

    def kill(self) -> None:
        """End the process at once, and all processes of its group."""
        self._connection.close()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()

    def _line(self, limit_s: float) -> bytes:
        """Read a line. Not :meth:`Connection.recv`: it unpickles, and waits without end for the rest of a message."""
        end = time.monotonic() + limit_s
        line, self._rest = self._rest, b""
        while b"\n" not in line:
            if len(line) > _MAX_ANSWER_BYTES:
                raise ValueError("longer than 1 MB")
            readable, _, _ = select.select([self._connection], [], [], max(0.0, end - time.monotonic()))
            if not readable:
                raise TimeoutError
            received = os.read(self._connection.fileno(), 1 << 16)
            if not received:
                raise EOFError
            line += received
        line, _, self._rest = line.partition(b"\n")
        return line + b"\n"
