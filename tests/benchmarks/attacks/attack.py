"""One attack on the project: what is done, what has to happen, and what was seen."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Seen:
    """What an attack caused."""

    #: Whether what was expected has happened.
    holds: bool
    #: What was seen, in one line.
    text: str


@dataclass(frozen=True)
class Attack:
    """One row of the table of attacks."""

    #: ``outputs`` or ``processes``.
    area: str
    #: What is done, in a few words.
    name: str
    #: What has to happen.
    expected: str
    #: Performs the attack in an empty folder that it is given, and returns what was seen. An exception that it raises
    #: is a failure of the project.
    run: Callable[[Path], Seen] = field(repr=False)
    #: The attack has to end within this time.
    limit_s: float = 60.0


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    #: The exit code; negative: the signal that ended it; -1000: still running at the limit, and killed.
    code: int
    #: Standard output.
    out: str
    #: Standard error.
    err: str


#: Exit code of a command that had to be killed, see :class:`Ended`.
TIMED_OUT = -1000


def command(
    *arguments: str | os.PathLike[str],
    folder: Path,
    environment: Mapping[str, str] | None = None,
    limit_s: float = 55.0,
) -> Ended:
    """Run ``slam-init`` in a process group of its own."""
    process = subprocess.Popen(
        program(arguments),
        cwd=folder,
        env={**os.environ, **(environment or {})},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="backslashreplace",
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        return Ended(TIMED_OUT, out, err)
    return Ended(process.returncode, out, err)


def program(arguments: Sequence[str | os.PathLike[str]]) -> list[str]:
    """Return the command line of ``slam-init``."""
    return [sys.executable, "-m", "slam_init", *(os.fspath(argument) for argument in arguments)]


def one_line(ended: Ended, code: int, *words: str) -> Seen:
    """Judge a command that has to end with one clear line."""
    lines = ended.err.splitlines()
    holds = (
        ended.code == code
        and len(lines) == 1
        and lines[0].startswith("slam-init: ")
        and all(word in lines[0] for word in words)
    )
    return Seen(holds, f"exit code {ended.code}: {' / '.join(lines[-2:])}"[:300])
