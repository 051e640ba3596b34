"""Attacks on the processes: methods of somebody else, and the end of a comparison."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import time
from functools import partial
from pathlib import Path

from tests.benchmarks.attacks import hostile
from tests.benchmarks.attacks.attack import IN_TIME, Attack, Ended, Pace, Seen, command, one_line, program, waited
from tests.benchmarks.attacks.process_tree import MARK, left_over, new_mark, processes_with

_AREA = "processes"
_SOURCE = "points:room?views=5&seed=1"
_HOSTILE = "tests.benchmarks.attacks.hostile"
_LIMITS = ("--time-limit", "2", "--memory-limit", "400", "--jobs", "1", "--out", "out")


def _compared(folder: Path, methods: str, mark: str, backend: str = "sequential") -> Ended:
    environment = {MARK: mark, hostile.PICKLE_FILE: str(folder / "unpickled")}
    options = ("--methods", methods, "--backend", backend, *_LIMITS)
    return command("compare", _SOURCE, *options, folder=folder, environment=environment)


def _loses_its_trial(name: str, folder: Path) -> Seen:
    """Compare a hostile method with two others: one runs before it, and one after it."""
    mark = new_mark()
    method = f"{_HOSTILE}:{name}"
    ended = _compared(folder, f"stella,{method},essential-8pt", mark)
    left = left_over(mark)
    if ended.code != 0:
        return Seen(False, f"exit code {ended.code}: {ended.err[-200:]}")
    with (folder / "out" / "results.csv").open(newline="") as file:
        rows = {row["method"]: row for row in csv.DictReader(file)}
    lost, others = rows.pop(method), rows.values()
    sound = all(row["outcome"] == "correct" for row in others) and len(others) == 2
    unpickled = (folder / "unpickled").exists()
    text = f"{lost['outcome']} ({lost['reason']}); the others: {', '.join(row['outcome'] for row in others)}"
    text += f"; {len(left)} processes left" + ("; code of the method ran in the comparison" if unpickled else "")
    return Seen(lost["outcome"] == "error" and sound and not left and not unpickled and not ended.err, text)


def _is_no_method(name: str, subcommand: str, folder: Path) -> Seen:
    source = _SOURCE if subcommand == "compare" else "synth:static?frames=2&width=96&height=64"
    option = "--methods" if subcommand == "compare" else "--method"
    ended = command(subcommand, source, option, name, "--out", "out", folder=folder)
    seen = one_line(ended, 2, "method")
    return Seen(seen.holds and not (folder / "out").exists(), seen.text)


def _module_is_hostile(text: str, folder: Path) -> Seen:
    (folder / "theirs.py").write_text(text)
    ended = command(
        "compare", _SOURCE, "--methods", "theirs:Method", "--out", "out", folder=folder,
        environment={"PYTHONPATH": os.pathsep.join((str(folder), os.environ.get("PYTHONPATH", "")))},
    )  # fmt: skip
    seen = one_line(ended, 2, "theirs:Method")
    return Seen(seen.holds and not (folder / "out").exists(), seen.text)


def _parent_is_killed(number: signal.Signals, backend: str, method: str, folder: Path) -> Seen:
    """Kill a comparison while a method hangs; no process may be left."""
    mark = new_mark()
    options = ("--methods", f"{_HOSTILE}:{method}", "--time-limit", "600", "--jobs", "2", "--backend", backend)
    process = subprocess.Popen(
        program(("compare", _SOURCE, *options, "--out", "out")), cwd=folder, env={**os.environ, MARK: mark},
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    running = _trial_runs(mark)
    count = len(processes_with(mark))
    process.send_signal(number)
    code = waited(process)
    left = left_over(mark)
    for each in left:
        os.kill(each, signal.SIGKILL)
    expected = -number if number == signal.SIGKILL else 128 + number
    return Seen(running and not left and code == expected, f"exit code {code}; {count} processes, {len(left)} left")


def _trial_runs(mark: str) -> bool:
    """Wait until a process computes a trial: the comparison has its journal, and a worker uses a core."""
    began = time.monotonic()
    while not Pace.is_over(began, IN_TIME):
        for process in processes_with(mark):
            try:
                words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
                ticks = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
            except OSError:  # it has ended
                continue
            # The check of the method is a worker without a limit of memory.
            if b"slam_init.compare.worker" in words and b"6000" in words and int(ticks[11]) > 100:
                time.sleep(0.3)
                return True
        time.sleep(0.05)
    return False


def _attack(name: str, expected: str, run: partial[Seen]) -> Attack:
    return Attack(_AREA, name, expected, run)


_LOST = "costs its own trial; the methods before and after it are correct; 0 processes left"
_DAMAGES = tuple(name for name, found in vars(hostile).items() if hasattr(found, "pair_rule") and name[0] != "_")
_NO_METHODS = ("sys:exit", "os:abort", "math:pi", "json:JSONDecoder", "nowhere:Method", ":", "a:b:c")
_MODULES = (
    ("exits at its import", "import sys\nsys.exit(0)\n"),
    ("ends the process at its import", "import os\nos._exit(0)\n"),
    ("raises at its import", "raise RuntimeError('two\\nlines')\n"),
    ("does not compile", "class Method\n"),
)

#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    *(
        _attack(f"compare a method that: {getattr(hostile, name).__doc__}", _LOST, partial(_loses_its_trial, name))
        for name in _DAMAGES
    ),
    *(
        _attack(
            f"{subcommand} with the method {name}", "one line, exit code 2", partial(_is_no_method, name, subcommand)
        )
        for subcommand in ("run", "compare")
        for name in _NO_METHODS
    ),
    *(
        _attack(f"compare a method whose module {name}", "one line, exit code 2", partial(_module_is_hostile, text))
        for name, text in _MODULES
    ),
    *(
        _attack(
            f"{number.name} to compare ({backend}) while a method loops in {method.removeprefix('LoopsIn')}",
            "it ends; 0 processes left",
            partial(_parent_is_killed, number, backend, method),
        )
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
        for backend, method in (("sequential", "LoopsInC"), ("loky", "LoopsInC"), ("loky", "LoopsInPython"))
    ),
)
