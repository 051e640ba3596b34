"""Attacks on the surroundings of a command: what a machine lacks, viewers that are killed.

Damaged files and mistyped commands are tests: ``tests/slam_init/command_line``, ``tests/slam_init/output``.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from tests.benchmarks.attacks.attack import (
    IN_TIME,
    Attack,
    Ended,
    Pace,
    Seen,
    command,
    finished,
    one_line,
    program,
    started,
    waited,
)
from tests.benchmarks.attacks.folders import STILL
from tests.benchmarks.attacks.process_tree import MARK, left_over, new_mark, processes_with

_AREA = "surroundings"
_LINE = "one line, exit code 2"
_POINTS = "points:room?views=5&seed=1"
_COMPARE = ("compare", _POINTS, "--methods", "stella", "--out", "out")


def _in_shell(before: str, arguments: Sequence[str], folder: Path) -> Ended:
    """Run a command in a shell with mounts of its own, after something was done there."""
    words = shlex.join(program(arguments))
    return finished(started(["unshare", "-m", "sh", "-c", f"{before}; exec {words}"], folder))


def _read_only_shm(folder: Path) -> Seen:
    ended = _in_shell("mount -t tmpfs -o ro tmpfs /dev/shm", (*_COMPARE, "--backend", "loky", "--jobs", "2"), folder)
    return one_line(ended, 2, "--backend sequential")


def _few_files(folder: Path) -> Seen:
    """What loky needs more files for ends in one line; where they are enough, the comparison is complete."""
    ended = _in_shell("ulimit -n 14", (*_COMPARE, "--backend", "loky", "--jobs", "2"), folder)
    if ended.code == 0:
        return Seen((folder / "out" / "report.html").exists(), "complete")
    return one_line(ended, 2)


def _no_home(folder: Path) -> Seen:
    """Libraries have no place for their caches."""
    bare = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/proc/x", "MPLCONFIGDIR": "/proc/y"}
    ended = command("run", STILL, "--quiet", "--out", "out", folder=folder, environment=bare)
    return Seen(ended.code == 3 and not ended.err and not ended.out, f"exit code {ended.code}: {ended.err[-200:]}")


def _viewer_is_killed(number: signal.Signals, options: tuple[str, ...], folder: Path) -> Seen:
    """Kill ``view`` or ``run --live``: no viewer with its ports may be left."""
    if command("run", STILL, "--quiet", "--no-overview", "--out", "out", folder=folder).code != 3:
        return Seen(False, "no recording")
    mark = new_mark()
    environment: Mapping[str, str] = {**os.environ, MARK: mark}
    process = subprocess.Popen(
        program(("view", "out", *options)), cwd=folder, env=environment, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    began = time.monotonic()
    while len(processes_with(mark)) < 3 and process.poll() is None and not Pace.is_over(began, IN_TIME):
        time.sleep(0.05)
    time.sleep(1.0)
    count = len(processes_with(mark))
    process.send_signal(number)
    waited(process)
    left = left_over(mark, within_s=10)
    for each in left:
        os.kill(each, signal.SIGKILL)
    return Seen(count >= 3 and not left, f"{count} processes, {len(left)} left")


#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    Attack(_AREA, "compare where /dev/shm is read-only", _LINE, _read_only_shm),
    Attack(_AREA, "compare where 14 files may be open", "complete, or one line", _few_files),
    Attack(_AREA, "run --quiet without a home", "no word, exit code 3", _no_home),
    *(
        Attack(
            _AREA,
            f"{number.name} to view {' '.join(options)}",
            "0 processes left",
            partial(_viewer_is_killed, number, options),
        )
        for number in (signal.SIGKILL, signal.SIGQUIT, signal.SIGTERM)
        for options in (("--web",), ("--screenshot", "v.png"))
    ),
)
