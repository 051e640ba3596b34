"""Runs ``slam-init bench`` after the command line has checked the options."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from slam_init.bench.generator import draw_archives
from slam_init.bench.manifest import MANIFEST, checksum, data_folder, find_sequences
from slam_init.bench.protocol import DEFAULTS, Run, frozen_checksum, rendered_worlds, simulated_worlds
from slam_init.bench.sheet import Sheet, sheet_of
from slam_init.bench.sheet_text import sheet_text
from slam_init.compare.command import not_applicable_lines
from slam_init.compare.plan import Plan
from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.run import Digests, Extras, compare
from slam_init.compare.sources import ComparedSource, describe_sources, open_compared
from slam_init.compare.trial_table import TrialTable
from slam_init.compare.trials import Settings
from slam_init.datasets.points import POINTS
from slam_init.errors import ConfigError, SourceError
from slam_init.output.names import DIGESTS, SHEET_FILES

_JSON, _MARKDOWN = SHEET_FILES


@dataclass(frozen=True)
class Execution:
    """How a run is computed. Nothing of this changes a figure, unless a trial misses its limit."""

    backend: str = "loky"
    jobs: int = 1
    time_limit_s: float = 300.0
    memory_limit_mb: int = 6000
    #: Write the trajectories in the formats of evo and VSLAM-LAB.
    trajectories: bool = False
    #: Show a progress bar on stderr.
    progress: bool = False


def run_bench(
    run: Run, out: str | os.PathLike[str], execution: Execution, generator: str | os.PathLike[str] | None = None
) -> str:
    """Run the benchmark, and write its results.

    * ``out``: Folder of the results: those of ``slam-init compare``, and ``sheet.json`` and ``sheet.md``.
    * ``generator``: Folder of the generator of the suite ``other``.
    """
    if generator is None:
        sources, notes = _sources(run)
    else:
        sources, notes = draw_archives(Path(generator), run.worlds, run.seed, Path(out))
    default = DEFAULTS[run.suite]
    plan = Plan(
        sources=tuple(sources),
        methods=run.methods,
        every=run.every,
        min_left=default.min_left,
        settings=Settings(
            seed=run.seed,
            limit_frames=default.limit_frames,
            time_limit_s=execution.time_limit_s,
            memory_limit_mb=execution.memory_limit_mb,
        ),
    )
    notes += not_applicable_lines(plan)
    made: list[Sheet] = []

    def _texts(table: TrialTable, plan: Plan, digests: Digests) -> Mapping[str, str]:
        known = {source.label: digests.get(source.label) or _digest(source) for source in plan.sources}
        sheet = sheet_of(table, plan, run, known, notes)
        made.append(sheet)
        return {_JSON: json.dumps(sheet.as_dict(), indent=1, allow_nan=False) + "\n", _MARKDOWN: sheet_text(sheet)}

    compare(
        plan,
        out,
        backend=execution.backend,
        jobs=execution.jobs,
        progress=execution.progress,
        command=shlex.join(run.words()),
        extras=Extras("bench", (*SHEET_FILES, DIGESTS), execution.trajectories, _texts),
    )
    return f"{sheet_text(made[-1])}\nsheet: {Path(out) / _MARKDOWN}, report: {Path(out) / 'report.html'}\n"


def list_text() -> str:
    """Describe the suites, and tell which public sequences are at hand and where to get the others."""
    lines = [f"{name:<10}{suite.about}" for name, suite in DEFAULTS.items()]
    try:
        folder = find_sequences(data_folder())
    except SourceError as error:
        lines += ["", f"video: {error}"]
        found: Mapping[str, Path] = {}
    else:
        lines += ["", f"sequences below {folder.root}: {len(folder.found)} of {len(MANIFEST)}"]
        found = folder.found
    for entry in MANIFEST:
        last = entry.first + entry.count - 1
        if entry.name in found:
            lines.append(f"  {entry.name:<20}{_state(entry.name, found[entry.name]):<22}{entry.title}")
        else:
            lines.append(
                f"  {entry.name:<20}{'missing':<22}{entry.title}, frames {entry.first} to {last} ({entry.layout}): "
                f"{entry.url}"
            )
    return "\n".join(lines) + "\n"


def _state(name: str, folder: Path) -> str:
    expected, found = frozen_checksum(name), checksum(folder)
    return "at hand" if expected == found else "at hand, not frozen" if expected is None else f"differs ({found})"


def _sources(run: Run) -> tuple[list[ComparedSource], list[str]]:
    """Describe the sources of a run, and tell which are missing."""
    if run.suite == "drawn":
        return describe_sources(simulated_worlds(run.worlds, run.seed)), []
    if run.suite == "rendered":
        return describe_sources(rendered_worlds(run.worlds, run.seed)), []
    folder = find_sequences(data_folder())
    wrong = [name for name in run.sequences if name not in folder.found]
    if wrong:
        raise ConfigError(f"{', '.join(wrong)}: no such sequence below {folder.root}; slam-init bench list tells which")
    chosen = {name: path for name, path in folder.found.items() if not run.sequences or name in run.sequences}
    if not chosen:
        raise SourceError(
            f"{folder.root} holds no sequence of the benchmark; slam-init bench list tells where to get them"
        )
    sources = describe_sources([str(path) for path in chosen.values()])
    notes = []
    if folder.missing and not run.sequences:
        names = ", ".join(entry.name for entry in folder.missing)
        notes.append(f"missing: {names}; slam-init bench list tells where to get them")
    for name, path in chosen.items():
        expected = frozen_checksum(name)
        if expected is not None and checksum(path) != expected:
            notes.append(f"{name}: its files are not those of the manifest: its figures cannot be compared")
    # Labels are names, so that the sheet does not depend on where the folder lies.
    return [replace(source, label=name, group=name) for name, source in zip(chosen, sources, strict=True)], notes


def _digest(source: ComparedSource) -> str:
    """The digest of the tracks of a source of points, which are not stored."""
    if not source.text.startswith(POINTS):
        return ""
    opened = open_compared(source.text)
    return tracks_digest(opened, replay(opened, source.text, 0, ""))
