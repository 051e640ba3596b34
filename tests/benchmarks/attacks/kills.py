"""Kills ``run`` and ``compare`` at random moments, over earlier results.

Run it as ``python -m tests.benchmarks.attacks.kills``. Each round starts a command in a folder with the results of
the round before, and ends it by SIGINT, SIGTERM or SIGKILL at a moment that is drawn over the length of a command. Then
it looks whether

* the earlier results are there to the byte, or the new ones are complete; where the command was killed between its
  renames, after the next command has completed them;
* each recording passes ``rerun rrd verify``;
* no process is left;
* the next command in the folder succeeds. Its results are the earlier ones of the next round.

Nine of ten commands are forked from this process, which has loaded the libraries, so that the moments fall on the work
and not on the start of Python. The tenth is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from slam_init.output.folder.marker import HOME
from tests.benchmarks.attacks.folders import contents, verified
from tests.benchmarks.attacks.process_tree import MARK, left_over, new_mark
from tests.benchmarks.options import show

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
#: Every tenth command is a process of its own.
_OWN_PROCESS = 10
#: Moments are drawn over the length of a command and a quarter more.
_BEYOND = 1.25
#: A command that takes longer hangs.
_LIMIT_S = 120.0
_METHODS = (("stella,quest", "sequential"), ("quest,stella", "loky"))


@dataclass(frozen=True)
class _Kind:
    """A command that is killed."""

    #: ``run`` or ``compare``.
    command: str
    #: The options that all commands of this kind have.
    arguments: tuple[str, ...]
    #: Further options, in turn: the results of two commands that follow one another differ.
    each: tuple[tuple[str, ...], ...]
    #: Files that grow during the command, so that they hold more than before after a kill.
    in_place: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Round:
    """What one kill left."""

    signal: str
    #: ``earlier``, ``new``, ``between`` (completed by the next command), or what is wrong.
    found: str
    #: Recordings that were verified.
    recordings: int
    #: Recordings that did not pass.
    broken: int
    #: Processes that were left.
    left: int
    #: Exit code of the next command.
    next_code: int
    #: The command ended before the signal.
    ended_first: bool

    @property
    def holds(self) -> bool:
        return self.found in ("earlier", "new", "between") and not self.broken and not self.left and self.next_code == 0


def main() -> int:
    """Kill commands, and write a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks.kills", description=__doc__)
    parser.add_argument("--runs", type=int, default=300, metavar="N", help="kills of run (default: 300)")
    parser.add_argument("--compares", type=int, default=100, metavar="N", help="kills of compare (default: 100)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the moments (default: 0)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to this file too")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary)
        sequence = _sequence(folder / "sequence")
        _load_libraries(sequence)
        seeds = tuple(("--seed", str(seed)) for seed in range(3))
        run = _Kind("run", (str(sequence), "--quiet"), seeds)
        sources = ("points:room?views=5&seed=1", "points:wall?views=5&seed=2")
        options = (*sources, "--every", "2", "--jobs", "1", "--methods")
        methods = tuple((names, "--backend", name) for names, name in _METHODS)
        compare = _Kind("compare", options, methods, ("trials.jsonl",))
        rounds: dict[str, list[_Round]] = {}
        for kind, count in ((run, arguments.runs), (compare, arguments.compares)):
            if count:
                rounds[kind.command] = _rounds(kind, count, folder / kind.command, rng)
            if arguments.out is not None:  # what is known so far, should the rest be stopped
                arguments.out.write_text("\n".join(_table(rounds)) + "\n")
    show("\n".join(_table(rounds)) + "\n", arguments.out)
    return 0 if all(one.holds for found in rounds.values() for one in found) else 1


def _rounds(kind: _Kind, count: int, out: Path, rng: random.Random) -> list[_Round]:
    from tqdm import tqdm

    durations = []
    for position in range(3):
        for name in kind.in_place if position else ():
            _forget_trials(out / name, 0)
        begin = time.monotonic()
        if _finish(_start(kind, position, out, new_mark(), own=False)) != 0:
            raise RuntimeError(f"{kind.command} fails without a kill")
        durations.append(time.monotonic() - begin)
    length_s = {False: statistics.median(durations), True: statistics.median(durations) + 2.0}
    rounds = []
    for position in tqdm(range(count), desc=kind.command, disable=None, leave=False):
        own = position % _OWN_PROCESS == 0
        moment_s = rng.uniform(0.0, _BEYOND * length_s[own])
        rounds.append(_round(kind, position, out, _SIGNALS[position % len(_SIGNALS)], moment_s, own=own))
        if not rounds[-1].holds:
            print(f"{kind.command} {position}, {moment_s:.3f} s: {rounds[-1]}", file=sys.stderr)
    return rounds


def _round(kind: _Kind, position: int, out: Path, number: signal.Signals, moment_s: float, *, own: bool) -> _Round:
    for name in kind.in_place:
        _forget_trials(out / name, position % 4)
    before = contents(out)
    mark = new_mark()
    process = _start(kind, position, out, mark, own=own)
    time.sleep(moment_s)
    ended_first = _ended(process)
    if not ended_first:
        os.kill(process, number)
    _finish(process)
    left = left_over(mark)
    for each in left:
        os.kill(each, signal.SIGKILL)
    found = _judged(kind, out, before)
    recordings = sorted(path for path in out.rglob("*.rrd") if HOME not in path.parts)
    broken = sum(not verified(path) for path in recordings)
    code = _finish(_start(kind, position + 1, out, new_mark(), own=False))
    return _Round(number.name, found, len(recordings), broken, len(left), code, ended_first)


def _judged(kind: _Kind, out: Path, before: dict[str, bytes]) -> str:
    """Return which results are in the folder."""
    pending = (out / HOME / "journal.json").exists()
    if pending:
        from slam_init.output.folder import OutputFolder

        with OutputFolder(out, kind.command):
            pass
    after = contents(out)
    if all(after.get(name) == content for name, content in before.items() if name not in kind.in_place) and all(
        after.get(name, b"").startswith(before.get(name, b"")) for name in kind.in_place
    ):
        return "earlier"
    try:
        summary = json.loads(after["summary.json"])
        whole = {"run": "attempts", "compare": "parts"}[kind.command] in summary
    except (KeyError, ValueError):
        whole = False
    listed = set(json.loads((out / HOME / "files.json").read_text())["files"])
    if not whole or listed != set(after) - {"interrupted.rrd"}:
        return f"neither the earlier results nor new ones: {sorted(listed ^ set(after))}"
    return "between" if pending else "new"


def _forget_trials(path: Path, kept: int) -> None:
    """Keep the settings and the first trials only, so that the next comparison has trials to run."""
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[: 1 + kept]))


# -- processes ---------------------------------------------------------------------------------------------------------


def _start(kind: _Kind, position: int, out: Path, mark: str, *, own: bool) -> int:
    """Start a command; return its process id."""
    arguments = [kind.command, *kind.arguments, *kind.each[position % len(kind.each)], "--out", str(out)]
    if own:
        command = [sys.executable, "-m", "slam_init", *arguments]
        null = subprocess.DEVNULL
        environment = os.environ | {MARK: mark}
        process = subprocess.Popen(command, env=environment, stdin=null, stdout=null, stderr=null)
        process.returncode = 0  # _finish waits for it
        return process.pid
    child = os.fork()
    if child == 0:
        _become(arguments, mark)
    return child


def _become(arguments: Sequence[str], mark: str) -> None:
    """Run a command in this forked process."""
    os.environ[MARK] = mark
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    code = 99
    try:
        from slam_init.cli import main as command_line

        code = command_line(arguments)
    finally:
        os._exit(code)


def _ended(process: int) -> bool:
    """Return whether a child has ended; it can still be waited for."""
    return os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _finish(process: int) -> int:
    """Wait for a child; return its exit code."""
    end = time.monotonic() + _LIMIT_S
    while not _ended(process):
        if time.monotonic() > end:
            os.kill(process, signal.SIGKILL)
        time.sleep(0.005)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def _sequence(folder: Path) -> Path:
    """Write a short sequence on which a run initializes."""
    from sequences_synth import write_tum
    from slam_init.datasets.synth import make_synth

    write_tum(make_synth("room", 0, {"frames": 10, "width": 320, "height": 240}), folder)
    return folder


def _load_libraries(sequence: Path) -> None:
    """Load and compile what a run needs. The recorder is not used here: a fork does not copy its threads."""
    import cv2

    from slam_init.config import Config
    from slam_init.datasets import open_source
    from slam_init.runner import run

    for module in (
        "rerun",
        "rerun.blueprint",
        "slam_init.cli",
        "slam_init.compare.run",
        "slam_init.compare.report",
        "loky",
    ):
        import_module(module)
    cv2.setNumThreads(1)
    source = open_source(str(sequence))
    assert source.camera is not None
    run(source, source.camera, Config())


# -- the table ---------------------------------------------------------------------------------------------------------


def _table(rounds: dict[str, list[_Round]]) -> list[str]:
    held = sum(one.holds for found in rounds.values() for one in found)
    lines = [f"{held} of {sum(map(len, rounds.values()))} kills held.", ""]
    lines.append(
        "| command | signal | kills | earlier results, to the byte | new ones, complete | killed between the renames | "
        "neither | recordings verified | not sound | processes left | next command failed | ended before the signal |"
    )
    lines.append("| --- | --- |" + " ---: |" * 10)
    for command, found in rounds.items():
        for name in (*(number.name for number in _SIGNALS), "all"):
            of = [one for one in found if name in (one.signal, "all")]
            kinds = Counter(one.found for one in of)
            counts = [
                len(of),
                kinds.pop("earlier", 0),
                kinds.pop("new", 0),
                kinds.pop("between", 0),
                sum(kinds.values()),
            ]
            counts += [sum(one.recordings for one in of), sum(one.broken for one in of), sum(one.left for one in of)]
            counts += [sum(one.next_code != 0 for one in of), sum(one.ended_first for one in of)]
            lines.append(f"| {command} | {name} | " + " | ".join(map(str, counts)) + " |")
    return lines


if __name__ == "__main__":
    sys.exit(main())
