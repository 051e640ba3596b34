"""Runs an external program with limits of time, memory and output.

The program runs under a guard, which leads a process group of its own: this file, run as a program. The whole group is
killed at the end of the program, at the time limit, and when this process ends, whatever ends it: the guard reads a
pipe whose other end this process holds. Of the output only the end is read. The file imports the standard library only,
so that a guard starts in 30 ms and needs no import path.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from threading import Thread

#: Kept end of the output: a traceback has a few kB.
_KEPT_BYTES = 16_384


def run_program(words: Sequence[str], time_limit_s: float, memory_limit_mb: int) -> tuple[str, str]:
    """Run a program without a shell, and wait for its end.

    * ``time_limit_s``: The program and all processes of its group are killed after this time.
    * Returns: Why it failed, as the rest of a sentence that starts with the program, empty if it exited with 0; and the
      end of what it wrote to stdout and stderr.
    """
    guard = [sys.executable, "-I", "-S", __file__, str(memory_limit_mb), *words]
    with tempfile.TemporaryFile() as log:
        try:
            process = subprocess.Popen(
                guard, stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )
        except OSError as error:  # as of arguments that are too long
            return f"cannot be started ({error.strerror})", ""
        try:
            failure = _failure(process.wait(time_limit_s))
        except subprocess.TimeoutExpired:
            failure = f"did not end within {time_limit_s:g} s and was killed"
        finally:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        log.seek(max(0, log.seek(0, os.SEEK_END) - _KEPT_BYTES))
        return failure, log.read().decode("utf-8", "replace")


def _failure(code: int) -> str:
    if code == 0:
        return ""
    if code < 0:
        with suppress(ValueError):
            return f"died ({signal.Signals(-code).name})"
    return f"exited with {code}"


def _guard(memory_limit_mb: int, words: list[str]) -> None:
    """Run a program in the group of this process, and exit as it does. Where stdin ends, kill the group."""

    def limit() -> None:
        if memory_limit_mb:
            hard = resource.getrlimit(resource.RLIMIT_AS)[1]
            most = memory_limit_mb * 2**20
            resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))

    def end_with_parent() -> None:
        sys.stdin.buffer.read()
        os.killpg(0, signal.SIGKILL)

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        program = subprocess.Popen(words, stdin=subprocess.DEVNULL, preexec_fn=limit)
    except OSError as error:
        sys.exit(f"{words[0]}: {error.strerror}")
    Thread(target=end_with_parent, daemon=True).start()
    code = program.wait()
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    _guard(int(sys.argv[1]), sys.argv[2:])
