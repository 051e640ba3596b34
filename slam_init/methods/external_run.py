"""Runs an external program with limits of time, memory and output.

The program leads a process group under a guard (:mod:`slam_init.system.process_guard`). The whole group is killed at
the end of the program, at the time limit, and when this process ends. Of the output only the end is kept.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from slam_init.errors import SlamInitError
from slam_init.system import process_guard

#: A process of a comparison has the import path of its parent in ``PYTHONPATH``. That of the user is in this variable:
#: an external program in another environment must not get ours.
USER_PYTHONPATH = "SLAM_INIT_USER_PYTHONPATH"
#: Kept end of the output: a traceback has a few kB.
_KEPT_BYTES = 16_384
#: Interval at which the end of the program is looked for while a process that it left keeps its output open.
_ASK_S = 0.05


@dataclass(frozen=True)
class ProgramRun:
    """How an external program ended."""

    #: Why it failed, as the rest of a sentence that starts with the program; empty if it exited with 0.
    failure: str
    #: The end of what it wrote to stdout and stderr.
    output: str
    #: Wall-clock time.
    seconds: float


def run_program(words: Sequence[str], time_limit_s: float, memory_limit_mb: int) -> ProgramRun:
    """Run a program without a shell, and wait for its end.

    * ``time_limit_s``: The program and all processes of its group are killed after this time.
    """
    begin = time.monotonic()
    try:
        process = subprocess.Popen(
            [*process_guard.launcher(memory_limit_mb), *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=_environment(),
        )
    except (OSError, ValueError) as error:
        raise SlamInitError(f"{words[0]} cannot be started ({getattr(error, 'strerror', None) or error})") from None
    in_time = False
    try:
        output, in_time = _output_until_end(process, begin + time_limit_s)
    finally:
        # The process is not yet waited for, so its group cannot be that of another process.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
    failure = _failure(process.returncode) if in_time else f"did not end within {time_limit_s:g} s and was killed"
    return ProgramRun(failure, output.decode("utf-8", "replace"), time.monotonic() - begin)


def _output_until_end(process: subprocess.Popen[bytes], end_s: float) -> tuple[bytes, bool]:
    """Read the output until the program has ended; return its end, and whether the program ended in time."""
    assert process.stdout is not None
    stream, kept, closed = process.stdout.fileno(), b"", False
    os.set_blocking(stream, False)
    while True:
        ended = os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        left_s = end_s - time.monotonic()
        if closed:
            time.sleep(0.0 if ended else max(0.0, min(_ASK_S, left_s)))
        else:
            select.select([stream], [], [], 0.0 if ended else max(0.0, min(_ASK_S, left_s)))
            kept, closed = _read(stream, kept)
        if ended:
            return kept, True
        if left_s <= 0:
            return kept, False


def _read(stream: int, kept: bytes) -> tuple[bytes, bool]:
    """Read what is there, at most 1 MB at a time, so that a program that never stops writing reaches its time limit."""
    for _ in range(16):
        try:
            more = os.read(stream, 1 << 16)
        except BlockingIOError:
            return kept, False
        if not more:
            return kept, True
        kept = (kept + more)[-_KEPT_BYTES:]
    return kept, False


def _failure(code: int) -> str:
    if code == 0:
        return ""
    if code < 0:
        with suppress(ValueError):
            return f"died ({signal.Signals(-code).name})"
    return f"exited with {code}"


def _environment() -> dict[str, str]:
    environment = dict(os.environ)
    if (path := environment.pop(USER_PYTHONPATH, None)) is not None:
        environment["PYTHONPATH"] = path
        if not path:
            del environment["PYTHONPATH"]
    return environment
