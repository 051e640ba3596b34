"""One attack on the project: what is done, what has to happen, and what was seen."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
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
    #: The attack has to end within the time of so many runs (:class:`Pace`).
    limit_runs: float = 10.0


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
#: A run on it initializes after 8 frames, and writes 1.1 MB.
ROOM = "synth:room?frames=14&width=320&height=240"


class Pace:
    """The time of a run on this machine at the moment: the unit of all limits of time.

    A limit in seconds fails where the machine is busy. A limit that is reached counts only after the pace was measured
    anew, so that a load that began in the meantime makes it longer.
    """

    _run_s: float | None = None

    @classmethod
    def run_s(cls, *, anew: bool = False) -> float:
        """Seconds of a run that finds a map. The first run compiles, and is not measured."""
        if cls._run_s is None or anew:
            for _ in range(1 if cls._run_s is not None else 2):
                began = time.monotonic()
                with tempfile.TemporaryDirectory() as folder:
                    words = program(("run", ROOM, "--quiet", "--out", "out"))
                    subprocess.run(words, cwd=folder, check=True, stdin=subprocess.DEVNULL, capture_output=True)
                cls._run_s = time.monotonic() - began
        assert cls._run_s is not None
        return cls._run_s

    @classmethod
    def is_over(cls, began: float, runs: float) -> bool:
        """Tell whether the time of so many runs has passed since a moment."""
        if time.monotonic() - began < runs * cls.run_s():
            return False
        seconds = time.monotonic() - began
        return seconds >= runs * cls.run_s(anew=True)


#: Within the time of so many runs a command has to end, a viewer to start, and a trial to begin.
IN_TIME = 8.0


def started(words: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
    """Start a program in a process group of its own."""
    return subprocess.Popen(
        words,
        cwd=folder,
        env={**os.environ, **(environment or {})},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="backslashreplace",
        start_new_session=True,
    )


def finished(process: subprocess.Popen[str], runs: float = IN_TIME) -> Ended:
    """Wait for a program; it is killed with its group after the time of so many runs."""
    began = time.monotonic()
    while True:
        try:
            out, err = process.communicate(timeout=max(runs * Pace.run_s() - (time.monotonic() - began), 0.1))
        except subprocess.TimeoutExpired:
            if Pace.is_over(began, runs):
                os.killpg(process.pid, signal.SIGKILL)
                out, err = process.communicate()
                return Ended(TIMED_OUT, out, err)
        else:
            return Ended(process.returncode, out, err)


def waited(process: subprocess.Popen[bytes], runs: float = IN_TIME) -> int:
    """Wait for a program that writes nothing: its exit code, or :data:`TIMED_OUT` where it does not end in time."""
    began = time.monotonic()
    while (code := process.poll()) is None:
        if Pace.is_over(began, runs):
            process.kill()
            process.wait()
            return TIMED_OUT
        time.sleep(0.02)
    return code


def command(*arguments: str | os.PathLike[str], folder: Path, environment: Mapping[str, str] | None = None) -> Ended:
    """Run ``slam-init`` in a process group of its own."""
    Pace.run_s()  # the first measurement lasts longer than many commands
    return finished(started(program(arguments), folder, environment))


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
