"""Give mutated files to each reader: ``python -m tests.benchmarks.fuzz --inputs 10000``.

A reader passes if it reads the file, or refuses it by an exception of the project with a message of one line. Any other
exception is a traceback, which counts as broken. The files are read in a child process, so that a crash of a C library
and an input that takes longer than 20 s are seen, counted and named; the next child goes on with the next input. Input
K of a reader is drawn from the seed and K alone, so that a broken one can be repeated: ``--only READER --first K
--inputs 1``.
"""

from __future__ import annotations

import argparse
import os
import selectors
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.benchmarks.fuzz.mutations import mutated
from tests.benchmarks.fuzz.targets import TARGETS
from tests.benchmarks.options import positive, show

_LIMIT_S = 20.0
# Of a child. An input that needs more than this is broken.
_MEMORY_BYTES = 6_000_000_000
_OUTCOMES = ("read", "refused", "broken", "crash", "hang")


@dataclass
class Outcomes:
    """What happened to the inputs of one reader."""

    #: Of ``read``, ``refused``, ``broken``, ``crash`` and ``hang``.
    counts: Counter[str] = field(default_factory=Counter)
    #: One line for each input that is broken, crashed or hung.
    findings: list[str] = field(default_factory=list)
    #: Time of the slowest input.
    longest_s: float = 0.0


def read_one(reader: str, seed: int, index: int, folder: Path) -> tuple[str, str]:
    """Read input ``index`` of a reader in this process: the outcome, and of a broken one what happened."""
    from slam_init.errors import SlamInitError

    target, rng = TARGETS[reader], np.random.default_rng([seed, index])
    seeds = _seeds(reader)
    names = sorted(seeds)
    name, other = (names[int(rng.integers(len(names)))] for _ in range(2))
    (folder / name).write_bytes(mutated(seeds[name], seeds[other], rng, is_text=target.is_text))
    try:
        target.read(folder, name)
    except SlamInitError as error:
        lines = str(error).splitlines()
        return ("refused", "") if len(lines) == 1 else ("broken", f"a message of {len(lines)} lines")
    except Exception as error:  # what a reader lets through is the finding
        return "broken", f"{name}: {type(error).__name__}: {' '.join(str(error).split())[:200]}"
    finally:
        (folder / name).write_bytes(seeds[name])
    return "read", ""


_MADE: dict[str, dict[str, bytes]] = {}


def _seeds(reader: str) -> dict[str, bytes]:
    """The sound files of a reader, made once in a process."""
    if reader not in _MADE:
        _MADE[reader] = dict(TARGETS[reader].seeds())
    return _MADE[reader]


def _child(reader: str, seed: int, first: int, stop: int, folder: Path) -> None:
    """Read inputs, and tell each outcome in a line."""
    import resource

    import cv2

    cv2.setNumThreads(1)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    for name, data in {**TARGETS[reader].around(), **_seeds(reader)}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    print("ready", flush=True)
    for index in range(first, stop):
        outcome, what = read_one(reader, seed, index, folder)
        print(index, outcome, what, flush=True)


def fuzz(reader: str, seed: int, first: int, stop: int) -> Iterator[tuple[int, str, str, float]]:
    """Read inputs in child processes: index, outcome, what happened, seconds of each."""
    while first < stop:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "tests.benchmarks.fuzz", "--child", reader, folder]
            command += [f"--seed={seed}", f"--first={first}", f"--inputs={stop - first}"]
            environment = {**os.environ, "OPENCV_LOG_LEVEL": "OFF", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
            child = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, env=environment
            )
            try:
                for index, outcome, what, seconds in _outcomes_of(child, first):
                    yield index, outcome, what, seconds
                    first = index + 1
            finally:
                child.kill()
                child.wait()


def _outcomes_of(child: subprocess.Popen[bytes], first: int) -> Iterator[tuple[int, str, str, float]]:
    """The outcomes that a child tells, and at its end the input that ended it."""
    assert child.stdout is not None
    stream, rest = child.stdout.fileno(), b""
    ready = False
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        since = time.monotonic()
        while True:
            # The start of a child imports OpenCV, and counts for no input.
            if not selector.select(_LIMIT_S if ready else 10 * _LIMIT_S):
                yield first, "hang", f"longer than {_LIMIT_S:g} s", time.monotonic() - since
                return
            if not (piece := os.read(stream, 1 << 16)):
                break
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                now = time.monotonic()
                if ready:
                    index, outcome, what = line.decode(errors="backslashreplace").split(" ", 2)
                    yield int(index), outcome, what, now - since
                    first = int(index) + 1
                ready, since = True, now
    if code := child.wait():
        if not ready:
            raise RuntimeError(f"a child ended with {code} before it read anything")
        yield first, "crash", f"the process ended with {code}", time.monotonic() - since


def _table(all_outcomes: dict[str, Outcomes]) -> str:
    from slam_init.output.tables import markdown_table, number

    header = ["reader", "inputs", *_OUTCOMES, "slowest input (s)"]
    rows = [
        [reader, str(o.counts.total()), *(str(o.counts[outcome]) for outcome in _OUTCOMES), number(o.longest_s, 2)]
        for reader, o in all_outcomes.items()
    ]
    findings = [f"- {reader}, {line}" for reader, o in all_outcomes.items() for line in o.findings[:20]]
    return "\n".join([markdown_table(header, rows), *(["", *findings] if findings else [])]) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; the exit code is 1 if an input was broken, crashed or hung."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.fuzz", allow_abbrev=False)
    parser.description = "Mutated files to each reader, in child processes."
    parser.add_argument("--inputs", type=positive, default=10_000, metavar="N", help="of each reader (default: 10000)")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="first input (default: 0)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the mutations (default: 0)")
    parser.add_argument("--only", choices=TARGETS, metavar="READER", help=f"one of {', '.join(TARGETS)}")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    stop = arguments.first + arguments.inputs
    if arguments.child:
        _child(arguments.child[0], arguments.seed, arguments.first, stop, Path(arguments.child[1]))
        return 0
    from tqdm import tqdm

    all_outcomes: dict[str, Outcomes] = {}
    for reader in [arguments.only] if arguments.only else TARGETS:
        outcomes = all_outcomes[reader] = Outcomes()
        told = fuzz(reader, arguments.seed, arguments.first, stop)
        for index, outcome, what, seconds in tqdm(told, total=arguments.inputs, desc=reader, disable=None, leave=False):
            outcomes.counts[outcome] += 1
            outcomes.longest_s = max(outcomes.longest_s, seconds)
            if outcome not in ("read", "refused"):
                outcomes.findings.append(f"input {index}: {outcome}, {what}")
    show(_table(all_outcomes), arguments.out)
    return 1 if any(o.findings for o in all_outcomes.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
