"""Compares the speed of two commits by ratios: ``python -m tests.benchmarks.speed_guard OLD NEW``.

OLD and NEW are folders: two checkouts of the project (``git worktree add FOLDER COMMIT``). The same program
(:mod:`tests.benchmarks.speed_probe`, of the tree that runs the guard) measures both, in new processes that take
turns: old, new, new, old, and so on. A process measures each task in units of a fixed piece of work, in CPU time, so
that the load of the machine matters little. The ratio new / old of each round is one observation. The table shows their
geometric mean with its 95 % interval (Student, of the logarithms).

The exit code is 1 if the whole interval of a task lies above the limit: the task has become slower by more than chance.
It is 2 if nothing could be compared. A task that one of the commits cannot do is listed and not compared.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.options import positive, show

#: A first process of each tree compiles and is not counted.
_WARM_UP = 1
#: A change below this factor is not reported as a regression, even where it is certain.
_LIMIT = 1.1
_PROBE = "speed_probe.py"


@dataclass(frozen=True)
class Change:
    """The change of the time of a task."""

    task: str
    #: old, new: Median time in units of the fixed piece of work; None if the commit cannot do the task.
    old: float | None
    new: float | None
    #: ratio, low, high: Geometric mean of the ratios new / old, and the ends of its 95 % interval; NaN if they are
    #: not known. With a single round the ends are 0 and infinity.
    ratio: float
    low: float
    high: float
    #: Number of ratios.
    rounds: int

    def is_regression(self, limit: float) -> bool:
        """Whether the whole interval lies above a limit."""
        return self.low > limit


def changes_of(rounds: Iterable[tuple[Mapping[str, float], Mapping[str, float]]]) -> list[Change]:
    """Compare the times of each task."""
    known = list(rounds)
    tasks = dict.fromkeys(task for old, new in known for task in (*old, *new))
    return [_change(task, known) for task in tasks]


def _change(task: str, rounds: Sequence[tuple[Mapping[str, float], Mapping[str, float]]]) -> Change:
    from statistics import fmean, median, stdev

    old, new = ([one[task] for one in of_tree if task in one] for of_tree in zip(*rounds, strict=True))
    logs = [math.log(b[task] / a[task]) for a, b in rounds if task in a and task in b]
    medians = (median(old) if old else None, median(new) if new else None)
    if not logs:
        return Change(task, *medians, math.nan, math.nan, math.nan, 0)
    mean = fmean(logs)
    half = math.inf if len(logs) < 2 else _student(len(logs) - 1) * stdev(logs) / math.sqrt(len(logs))
    high = math.inf if half == math.inf else math.exp(mean + half)
    return Change(task, *medians, math.exp(mean), math.exp(mean - half), high, len(logs))


def _student(freedom: int) -> float:
    """Half-width of the two-sided 95 % interval in standard errors."""
    from scipy.stats import t

    return float(t.ppf(0.975, freedom))


def changes_table(changes: Sequence[Change], limit: float) -> str:
    """Make the table."""
    from slam_init.output.tables import markdown_table, number

    rows = []
    for one in changes:
        known = one.rounds > 0
        interval = f"{one.low:.2f} to {one.high:.2f}" if known else "-"
        verdict = f"above {limit:g}" if one.is_regression(limit) else "faster" if one.high < 1 else ""
        times = [number(one.old, 3), number(one.new, 3)]
        rows.append([one.task, *times, f"{one.ratio:.2f}" if known else "-", interval, str(one.rounds), verdict])
    header = ["CPU time over the flow", "old", "new", "new / old", "95 % interval", "rounds", ""]
    return markdown_table(header, rows)


def measure_tree(tree: Path) -> dict[str, float]:
    """Measure a checkout in a new process.

    * ``tree``: With the folders ``slam_init``, ``quest`` and ``sequences_synth``.
    * Returns: Time of each task that it can do, in units of the fixed piece of work.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "TBB_NUM_THREADS"), "1")
    # -P: the folder of the probe is that of this tree, and its modules must not hide those of the other.
    command = [sys.executable, "-P", str(Path(__file__).with_name(_PROBE)), str(tree.resolve())]
    environment = os.environ | threads | {"PYTHONPATH": str(tree.resolve())}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=tree)
    if done.returncode:
        raise RuntimeError(f"{tree} cannot be measured: {done.stderr.strip()[-500:]}")
    times: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return times


def _rounds(old: Path, new: Path, count: int) -> list[tuple[dict[str, float], dict[str, float]]]:
    """Measure both trees in turns; which one is first alternates."""
    from tqdm import tqdm

    found = []
    for k in tqdm(range(-_WARM_UP, count), unit="round", disable=None, leave=False):
        first, second = (old, new) if k % 2 == 0 else (new, old)
        times = {first: measure_tree(first), second: measure_tree(second)}
        if k >= 0:
            found.append((times[old], times[new]))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.speed_guard", allow_abbrev=False)
    parser.description = "Compare the speed of two checkouts; exit code 1 if a task has become slower."
    parser.add_argument("old", type=Path, help="folder of a checkout")
    parser.add_argument("new", type=Path, help="folder of another checkout")
    parser.add_argument("--rounds", type=positive, default=6, metavar="N", help="of both (default: 6)")
    parser.add_argument("--limit", type=float, default=_LIMIT, metavar="X", help=f"of new / old (default: {_LIMIT:g})")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    options = parser.parse_args(argv)
    for tree in (options.old, options.new):
        if not (tree / "slam_init").is_dir():
            parser.error(f"{tree} is no checkout of the project: it has no folder slam_init")
    if options.old.resolve() == options.new.resolve():
        parser.error("OLD and NEW are the same folder: add a worktree of the other commit")
    changes = changes_of(_rounds(options.old, options.new, options.rounds))
    show(changes_table(changes, options.limit) + "\n", options.out)
    if not any(one.rounds for one in changes):
        return 2
    return int(any(one.is_regression(options.limit) for one in changes))


if __name__ == "__main__":
    sys.exit(main())
