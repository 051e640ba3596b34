"""One attack on the project: what is done, what has to happen, and what was seen."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Attack", "Ended", "Seen", "command", "one_line", "program"]


@dataclass(frozen=True)
class Seen:
    """What an attack caused.

    Attributes
    ----------
    holds : bool
        Whether what was expected has happened.
    text : str
        What was seen, in one line.
    """

    holds: bool
    text: str


@dataclass(frozen=True)
class Attack:
    """One row of the table of attacks.

    Attributes
    ----------
    area : str
        ``command line``, ``readers``, ``API``, ``outputs`` or ``processes``.
    name : str
        What is done, in a few words.
    expected : str
        What has to happen.
    run : callable
        Performs the attack in an empty folder that it is given, and returns what was seen. An exception that it raises
        is a failure of the project.
    limit_s : float
        The attack has to end within this time.
    """

    area: str
    name: str
    expected: str
    run: Callable[[Path], Seen] = field(repr=False)
    limit_s: float = 60.0


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : int
        The exit code; negative: the signal that ended it; -1000: still running at the limit, and killed.
    out : str
        Standard output.
    err : str
        Standard error.
    """

    code: int
    out: str
    err: str


#: Exit code of a command that had to be killed, see :class:`Ended`.
TIMED_OUT = -1000


def command(
    *arguments: str | os.PathLike[str],
    folder: Path,
    environment: Mapping[str, str] | None = None,
    limit_s: float = 55.0,
) -> Ended:
    """Run ``slam-init`` in a process group of its own.

    Parameters
    ----------
    *arguments : str or path
        Of ``slam-init``.
    folder : Path
        Working directory.
    environment : mapping of str to str, optional
        Added to the environment.
    limit_s : float
        After this time the process group is killed.

    Returns
    -------
    Ended
    """
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
    """Return the command line of ``slam-init``.

    Parameters
    ----------
    arguments : sequence of str or path
        Of ``slam-init``.

    Returns
    -------
    list of str
    """
    return [sys.executable, "-m", "slam_init", *(os.fspath(argument) for argument in arguments)]


def one_line(ended: Ended, code: int, *words: str) -> Seen:
    """Judge a command that has to end with one clear line.

    Parameters
    ----------
    ended : Ended
    code : int
        The exit code that is expected.
    *words : str
        The line must contain each of them.

    Returns
    -------
    Seen
    """
    lines = ended.err.splitlines()
    holds = (
        ended.code == code
        and len(lines) == 1
        and lines[0].startswith("slam-init: ")
        and all(word in lines[0] for word in words)
    )
    return Seen(holds, f"exit code {ended.code}: {' / '.join(lines[-2:])}"[:300])
