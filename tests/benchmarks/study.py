"""Success rate and time of initialization on drawn worlds: ``python -m tests.benchmarks.study --out DIR``.

Each part of the study is a table. All methods run on the same tracks. The tracks are drawn from the distribution that
:mod:`tests.benchmarks.study_parts` describes. Maps are classified as in :mod:`slam_init.compare`: a map is
*correct* within 5 degrees in rotation and 15 degrees in the direction of the baselines, *strict* within 1 and 5
degrees, and otherwise *false*.

* Shares have 95 % intervals (Wilson).
* *Frames to correct* is a restricted mean: a trial with a false map or without a map counts as its limit.
* *Difference to* is the mean over the trials of the difference to the first method, with its 95 % interval.
* *Correct of solvable*: of the worlds in which at least one method finds a correct map, the share in which this method
  finds one.
* *Ambiguous: correct hypothesis kept*: of the trials that ended with an ambiguous plane, the number in which one of the
  stored hypotheses is correct.

A killed run can be resumed with the same command. Each part writes its trials and a report to its own folder.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from slam_init.compare.command import chosen_methods
from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.trials import Settings
from slam_init.errors import SlamInitError
from slam_init.methods import METHODS
from tests.benchmarks.options import positive
from tests.benchmarks.study_parts import PARTS, sources_of
from tests.benchmarks.study_tables import moving_table, read_rows, static_table

_METHODS = ("quest", "quest-two-view", "orb-slam3", "stella", "essential-5pt", "poselib")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the chosen parts; print their tables and write them to ``DIR/PART.md``.

    * Returns: 2 if an option is wrong or a file cannot be written, with one line on stderr; otherwise 0.
    """
    arguments = _parser().parse_args(argv)
    try:
        methods = chosen_methods(arguments.methods or ",".join(_installed()))
        arguments.out.mkdir(parents=True, exist_ok=True)
        for part in arguments.part or PARTS:
            text = run_part(part, arguments.out, arguments.trials, methods, arguments.seed, arguments.jobs)
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
            (arguments.out / f"{part}.md").write_text(text, encoding="utf-8")
    except (SlamInitError, OSError) as error:
        sys.stderr.write(f"study: error: {error}\n")
        return 2
    return 0


def run_part(part: str, out: str | os.PathLike[str], trials: int, methods: Sequence[str], seed: int, jobs: int) -> str:
    """Run one part and return its text in markdown."""
    folder = Path(out) / part
    described = PARTS[part]
    cells = described.cells(trials, seed)
    plan = Plan(sources_of(cells), tuple(methods), settings=Settings(seed=seed))
    compare(plan, folder, jobs=jobs, progress=sys.stderr.isatty())
    make = static_table if described.no_translation else moving_table
    table = make(cells, read_rows(folder), plan.methods)
    return f"## {described.title}\n\n{described.text} {trials} worlds per row.\n\n{table}\n"


def _installed() -> list[str]:
    """Return the methods whose packages are installed; print the others on stderr."""
    missing = [name for name in _METHODS if (needs := METHODS[name].needs) is not None and find_spec(needs) is None]
    for name in missing:
        sys.stderr.write(f"study: {name} is left out: pip install {METHODS[name].needs}\n")
    return [name for name in _METHODS if name not in missing]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the tables and trials")
    parser.add_argument("--trials", type=positive, default=20, metavar="N", help="worlds per row of a table (20)")
    parser.add_argument("--methods", metavar="A,B", help=f"default: {','.join(_METHODS)}")
    parser.add_argument("--part", action="append", choices=tuple(PARTS), help="may be repeated; default: all")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--jobs", type=positive, default=1, metavar="N", help="processes (1)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
