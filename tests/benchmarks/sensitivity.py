"""Sensitivity: what halving and doubling does to the decisions, for each number that decides.

The numbers are those of ``docs/make/numbers_page.py`` that a map by tracks can depend on. Each is halved and doubled,
alone; a share of a half or more is moved half the way to one in place of being doubled. A forked process changes the
number in all modules that hold it, and decides the worlds. Compiled code reads none of them as a global: they are
arguments there. ::

    python -m tests.benchmarks.sensitivity --log sensitivity.jsonl
    python -m tests.benchmarks.sensitivity --worlds A/gen.py:22000-22020 --worlds B/gen.py:500-510 --log other.jsonl
    python -m tests.benchmarks.sensitivity --from-log sensitivity.jsonl --out table.md
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import multiprocessing
import pkgutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import quest
import slam_init
from tests.benchmarks.options import progress, show
from tests.benchmarks.reliability import World, built_in, by_another_hand, commit, decide
from tests.benchmarks.tables import markdown_table

_ROOT = Path(__file__).resolve().parents[2]
LEVELS = "slam_init/window/levels.py"
#: Modules whose numbers decide on joined maps, on maps of others, or on images before there are tracks.
_NOT_OF_A_MAP = ("audit", "static_tracks", "static_overlay")
#: A world ends after so many views: most maps come within ten.
_VIEWS = 14


@dataclass(frozen=True)
class Change:
    """A number and the value that it is given."""

    file: str
    name: str
    kind: str
    factor: float


def changes() -> Iterator[Change]:
    """Each number halved and doubled; after :func:`load_all`."""
    numbers_page = _module(_ROOT / "docs" / "make" / "numbers_page.py")
    for file in numbers_page.files():
        for number in numbers_page.numbers(file):
            if number.kind not in ("", "definition"):
                for name in number.names:
                    if _is_of_a_map(file, name):
                        yield from (Change(file, name, number.kind, factor) for factor in (0.5, 2.0))


def _is_of_a_map(file: str, name: str) -> bool:
    """Whether a module that decides on a map by tracks holds a number; levels alone are held by those that use them."""
    users = {Path(file).stem}
    if file == LEVELS:
        users = {module.__name__.rpartition(".")[2] for module in holders(name, getattr(_home(file), name))} - users
    return not users <= set(_NOT_OF_A_MAP)


def _module(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"sensitivity: {path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def load_all() -> None:
    """Import all modules that hold numbers, so that a change reaches each of them."""
    for package in (quest, slam_init):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith("__main__") and not any(part in found.name for part in (".ros", ".live")):
                importlib.import_module(found.name)
    importlib.import_module("slam_init.window.live")


def scaled(value: Any, factor: float) -> Any:
    """Halve or double a number, or the numbers of a tuple or an array."""
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    if isinstance(value, np.ndarray):
        return value * factor
    if factor > 1.0 and 0.5 <= value < 1.0:
        return 0.5 * (1.0 + value)
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def apply(change: Change) -> None:
    """Change a number in all modules that hold it, or the default of a field of a class."""
    home = _home(change.file)
    owner, _, field = change.name.rpartition(".")
    if owner:
        kind = getattr(home, owner)
        value = scaled(getattr(kind, field), change.factor)
        names = [name for name in kind.__match_args__ if hasattr(kind, name)]
        if field in names:
            defaults = list(kind.__init__.__defaults__)
            defaults[names.index(field) - len(names)] = value
            kind.__init__.__defaults__ = tuple(defaults)
        setattr(kind, field, value)
        return
    old = getattr(home, field)
    new = scaled(old, change.factor)
    for module in holders(field, old):
        setattr(module, field, new)


def _home(file: str) -> ModuleType:
    return sys.modules[file.removesuffix(".py").replace("/", ".")]


def holders(name: str, value: Any) -> list[ModuleType]:
    """The modules that hold a number under its name: its own, and those that import it."""
    modules = [module for key, module in sys.modules.items() if key.startswith(("slam_init.", "quest."))]
    return [module for module in modules if vars(module).get(name) is value]


_worlds: list[World] = []


def _decide_all(change: Change | None) -> list[tuple[str, int, float]]:
    """The decisions of all worlds, with a number changed in this process; "fails" where the code does."""
    if change is not None:
        apply(change)
    found = []
    for world in _worlds:
        try:
            decision = decide(world, 0)
        except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError):
            found.append(("fails", 0, 0.0))
            continue
        found.append((decision.outcome, decision.wait, decision.risk if decision.outcome != "none" else 0.0))
    return found


def _work(change: Change | None) -> tuple[Change | None, list[tuple[str, int, float]]]:
    return change, _decide_all(change)


def measure(log: Path, jobs: int) -> None:
    """Decide the worlds with each change that the log does not hold yet, and add a line for each."""
    known = {tuple(line["change"]) for line in _lines(log)} if log.exists() else set()
    load_all()
    todo: list[Change | None] = [None] if () not in known else []
    todo += [one for one in changes() if (one.file, one.name, one.kind, one.factor) not in known]
    _decide_all(None)
    context = multiprocessing.get_context("fork")
    with context.Pool(jobs, maxtasksperchild=1) as pool:
        for change, found in progress(pool.imap(_work, todo), "changes", len(todo)):
            key = [] if change is None else [change.file, change.name, change.kind, change.factor]
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"change": key, "decisions": found, "commit": commit()}) + "\n")


def _lines(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def report(logs: Sequence[Path]) -> str:
    """The table of some logs, each of its own worlds; numbers that change no decision are listed below it."""
    decisions: dict[tuple[Any, ...], list[Any]] = {}
    commits = set()
    for log in logs:
        for line in _lines(log):
            commits.add(line["commit"])
            decisions.setdefault(tuple(line["change"]), []).extend(line["decisions"])
    base = decisions.pop(())
    rows, still, names = [], [], sorted({key[:3] for key in decisions}, key=lambda key: (key[0], key[1]))
    for file, name, kind in names:
        cells = [decisions[file, name, kind, factor] for factor in (0.5, 2.0)]
        changed = [sum(one[:2] != other[:2] for one, other in zip(base, cell, strict=True)) for cell in cells]
        if not any(changed):
            still.append(f"`{name}` ({Path(file).stem})")
            continue
        both = zip(changed, cells, strict=True)
        rows.append([f"`{name}`", Path(file).stem, kind, *(text for n, cell in both for text in (str(n), _told(cell)))])
    head = ["number", "module", "class", "halved: other", "right/false/none, wait", "doubled: other", "the same"]
    fails = sum(one[0] == "fails" for cell in decisions.values() for one in cell)
    return (
        f"Commit {', '.join(sorted(commits))}. {len(base)} worlds; as it is: {_told(base)}. Worlds that decide "
        "otherwise (another outcome or another frame), outcomes, and the mean wait of the maps in frames. Decisions "
        f"that failed: {fails}."
        "\n\n"
        f"{markdown_table(head, rows)}\n\n"
        f"No decision differs, halved or doubled ({len(still)} numbers): {', '.join(still)}.\n"
    )


def _told(cell: Sequence[Sequence[Any]]) -> str:
    counts = [sum(one[0] == outcome for one in cell) for outcome in ("correct", "false", "none")]
    waits = [one[1] for one in cell if one[0] in ("correct", "false")]
    return f"{'/'.join(map(str, counts))}, {np.mean(waits) if waits else 0:.2f}"


def _drawn(specification: str) -> Iterator[World]:
    """The worlds ``FILE:FIRST-END`` of another generator."""
    path, _, seeds = specification.rpartition(":")
    first, _, end = seeds.partition("-")
    if not (first.isdecimal() and end.isdecimal() and Path(path).is_file()):
        raise SystemExit(f"sensitivity: {specification!r}: give FILE:FIRST-END")
    worlds = by_another_hand(Path(path))
    for seed in range(int(first), int(end)):
        yield from worlds(seed)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure or print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.sensitivity", allow_abbrev=False)
    parser.description = "What halving and doubling each number that decides does to the decisions."
    parser.add_argument("--worlds", action="append", metavar="FILE:FIRST-END", help="worlds by another hand")
    parser.add_argument("--log", type=Path, metavar="FILE", help="one JSON line a change; a run goes on with it")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--from-log", type=Path, nargs="+", metavar="FILE", help="table of logs; run nothing")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    options = parser.parse_args(argv)
    if options.from_log:
        show(report(options.from_log), options.out)
        return 0
    if options.log is None:
        parser.error("give --log or --from-log")
    given = options.worlds
    drawn = (one for text in given for one in _drawn(text)) if given else (one for one in built_in(210_000))
    _worlds.extend(replace(one, views=one.views[:_VIEWS]) for one in drawn)
    measure(options.log, options.jobs)
    show(report([options.log]), options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
