"""How soon, how often and how rightly ``quest`` initializes: ``python -m slam_init.benchmarks.study --out DIR``.

Every part is a table. The methods run side by side on the same tracks, drawn from the distribution that
:mod:`slam_init.benchmarks.study_parts` states; every map is judged as in :mod:`slam_init.compare`: *correct* within 5
degrees in rotation and 15 in the direction of the baselines, *strict* within 1 and 5, else *false*.

* Shares have 95 % intervals (Wilson).
* *Frames to correct* is the restricted mean: a trial without a correct map counts as its limit, as one with a false map
  does. *More than* is the mean of the differences to the first method, trial by trial, with its 95 % interval.
* *Of those any solves*: of the worlds in which at least one of the methods finds a correct map, the share of this one.
* *Of ambiguous*: of the runs that ended with an undecided plane, those in which one of the kept maps is correct.

The parts: ``general``, ``planar``, ``still``, ``hard``, ``noise-baseline``, ``ablation``
(:mod:`slam_init.benchmarks.study_ablation`) and ``map-quality`` (:mod:`slam_init.benchmarks.map_quality`). A run that
was killed goes on where it stopped; each part leaves its trials and a report in a folder of its own.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from slam_init.benchmarks.map_quality import map_quality_table
from slam_init.benchmarks.options import positive
from slam_init.benchmarks.study_ablation import run_ablation
from slam_init.benchmarks.study_oracle import solvable_worlds
from slam_init.benchmarks.study_parts import PARTS, Cell, sources_of
from slam_init.benchmarks.study_tables import grid_table, moving_table, read_rows, still_table
from slam_init.compare.command import chosen_methods
from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.trials import Settings
from slam_init.errors import SlamInitError
from slam_init.methods import METHODS

__all__ = ["main", "run_part"]

_METHODS = ("quest", "quest-two-view", "orb-slam3", "stella", "essential-5pt", "poselib")
_GRID, _ABLATION, _MAP_QUALITY = "noise-baseline", "ablation", "map-quality"
_ALL = (*PARTS, _ABLATION, _MAP_QUALITY)
#: The difference of two adjustments of the same tracks hardly varies: thirty worlds show its sign.
_MAP_QUALITY_WORLDS = 30


def main(argv: Sequence[str] | None = None) -> int:
    """Run the parts that were asked for; print their tables and write them to ``DIR/PART.md``.

    Returns
    -------
    int
        2 where an option is wrong or nothing can be written, told in one line; else 0.
    """
    arguments = _parser().parse_args(argv)
    try:
        methods = chosen_methods(arguments.methods or ",".join(_installed()))
        arguments.out.mkdir(parents=True, exist_ok=True)
        for part in arguments.part or _ALL:
            text = run_part(part, arguments.out, arguments.trials, methods, arguments.seed, arguments.jobs)
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
            (arguments.out / f"{part}.md").write_text(text, encoding="utf-8")
    except (SlamInitError, OSError) as error:
        sys.stderr.write(f"study: error: {error}\n")
        return 2
    return 0


def run_part(part: str, out: Path, trials: int, methods: Sequence[str], seed: int, jobs: int) -> str:
    """Run a part and return it as markdown.

    Parameters
    ----------
    part : str
        Of those that the module names.
    out : Path
        Holds a folder for each part.
    trials : int
        Worlds in each row of a table.
    methods : sequence of str
        The first one is what the others are compared with.
    seed, jobs : int

    Raises
    ------
    SlamInitError
        As :func:`slam_init.compare.run.compare`.
    """
    progress = sys.stderr.isatty()
    if part == _ABLATION:
        text = f"{trials} worlds a scene, with one thing switched off at a time: correct / false / none."
        return _section("Ablation", text, run_ablation(out / part, trials, seed, jobs, progress=progress))
    if part == _MAP_QUALITY:
        table = map_quality_table(min(trials, _MAP_QUALITY_WORLDS), seed, progress=progress)
        text = "The same tracks and the same start, adjusted by us and by pycolmap: medians over the worlds."
        return _section("Map quality", text, table)
    described = PARTS[part]
    cells = described.cells(trials, seed)
    chosen = tuple(methods[:1]) if part == _GRID else tuple(methods)
    compare(Plan(sources_of(cells), chosen, settings=Settings(seed=seed)), out / part, jobs=jobs, progress=progress)
    rows = read_rows(out / part)
    if part == _GRID:
        table = grid_table(cells, rows, chosen[0], _solvable(cells))
        return _section(described.title, f"{described.text} {trials} worlds a cell.", table)
    make = still_table if described.still else moving_table
    return _section(described.title, f"{described.text} {trials} worlds a row.", make(cells, rows, chosen))


def _solvable(cells: Sequence[Cell]) -> set[str] | None:
    """The worlds that hold the information; None where pycolmap, which tells, is not installed."""
    if find_spec("pycolmap") is None:
        sys.stderr.write("study: which worlds are solvable is left out: pip install pycolmap\n")
        return None
    return solvable_worlds(text for cell in cells for text in cell.sources)


def _section(title: str, text: str, table: str) -> str:
    return f"## {title}\n\n{text}\n\n{table}\n"


def _installed() -> list[str]:
    """The methods of the study whose packages are there; which are not is told."""
    missing = [name for name in _METHODS if (needs := METHODS[name].needs) is not None and find_spec(needs) is None]
    for name in missing:
        sys.stderr.write(f"study: {name} is left out: pip install {METHODS[name].needs}\n")
    return [name for name in _METHODS if name not in missing]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m slam_init.benchmarks.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the tables and trials")
    parser.add_argument("--trials", type=positive, default=20, metavar="N", help="worlds a row of a table (20)")
    parser.add_argument("--methods", metavar="A,B", help=f"default: {','.join(_METHODS)}")
    parser.add_argument("--part", action="append", choices=_ALL, help="may be given several times; default: all")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--jobs", type=positive, default=1, metavar="N", help="processes (1)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
