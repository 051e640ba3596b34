"""Runs ``slam-init compare`` after the command line has checked the options."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from slam_init.compare.figures import WaitDifference
from slam_init.compare.isolation import check_method
from slam_init.compare.plan import Plan
from slam_init.compare.reliability import Reliability
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources, grid_sources
from slam_init.compare.summary import ComparisonSummary
from slam_init.compare.tables import QUALITY, RATES, STATIC, figure_text, text_figures
from slam_init.compare.trial_table import LEVELS, PARTS
from slam_init.compare.trials import Settings
from slam_init.config import Config
from slam_init.datasets.views import SourceView
from slam_init.errors import ConfigError
from slam_init.methods.external_command import is_external, method_label
from slam_init.output.tables import fitted_tables

#: The options on which the results depend, and their defaults.
_OPTIONS = (
    ("methods", None), ("every", 10), ("min_left", 3), ("grid", 0), ("limit_frames", 150), ("seed", 0),
    ("use_every", 1), ("fps", None), ("mask", None), ("camera", None),
)  # fmt: skip


def run_command(arguments: argparse.Namespace, out: str | os.PathLike[str], *, progress: bool) -> str:
    """Run a comparison."""
    methods = chosen_methods(arguments.methods, arguments.method)
    texts = [*arguments.sources, *grid_sources(arguments.grid, arguments.seed)]
    view = SourceView(arguments.use_every, arguments.fps, arguments.mask, arguments.camera)
    plan = Plan(
        sources=tuple(describe_sources(texts, view)),
        methods=methods,
        every=arguments.every,
        min_left=arguments.min_left,
        settings=Settings(
            seed=arguments.seed,
            limit_frames=arguments.limit_frames,
            time_limit_s=arguments.time_limit,
            memory_limit_mb=arguments.memory_limit,
            audit=arguments.audit,
            config=Config(),
        ),
    )
    summary = compare(
        plan,
        out,
        backend=arguments.backend,
        jobs=arguments.jobs or os.cpu_count() or 1,
        recordings=arguments.recordings,
        progress=progress,
        command=_command(arguments),
    )
    left_out = "".join(f"{line}\n" for line in not_applicable_lines(plan))
    return f"{main_table(summary)}\n\n{left_out}report: {Path(out) / 'report.html'}\n"


def not_applicable_lines(plan: Plan) -> list[str]:
    """Tell which methods were left out on which sources."""
    return [
        f"not applicable: {method_label(method)} on {count} points: sources, because an external program needs images"
        for method, count in plan.not_applicable().items()
    ]


def chosen_methods(text: str | None, further: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the methods of the options ``--methods`` and ``--method``.

    * ``text``: Names, separated by commas; None for all methods whose packages are installed, each under one name.
    * ``further``: Further methods. The command of an external program may hold commas.
    """
    from slam_init.methods import METHODS, method_info

    if text is None:
        installed = (info for info in METHODS.values() if info.needs is None or find_spec(info.needs))
        text = ",".join(info.name for info in installed if info.alias_of is None and info.name not in further)
    names = (*(text.split(",") if text else ()), *further)
    for name in names:
        info = method_info(name)
        if info.needs is not None and find_spec(info.needs) is None:
            raise ConfigError(f"the method {name} needs the package {info.needs}: pip install {info.needs}")
        if names.count(name) > 1:
            raise ConfigError(f"the method {name} is given twice: give each method once")
    labels = [method_label(name) for name in names]
    for label in labels:
        if labels.count(label) > 1:
            raise ConfigError(f"two methods are named {label}: name one, as in NAME=command:PROGRAM ...")
    for name in names:
        if ":" in name and not is_external(name):
            check_method(name)
    return names


def main_table(summary: ComparisonSummary) -> str:
    """Return the main table of each part of a comparison.

    * Returns: Tables in markdown: for each part the methods, and for a moving camera the paired differences of the
      wait. Then the reliability of the stated risk, if a method states one.
    """
    tables = []
    for part, title in PARTS.items():
        if part in summary.parts:
            columns = STATIC if part.endswith("static") else (*RATES, *QUALITY)
            tables.append(text_figures(title, summary.parts[part], columns))
        if summary.waits.get(part):
            tables.append(_wait_table(summary.waits[part]))
    tables += [_risk_table(LEVELS[level], by_method) for level, by_method in summary.reliability.items()]
    return "\n\n".join(tables)


def _wait_table(differences: Sequence[WaitDifference]) -> str:
    header = [f"wait of {differences[0].first} minus that of", "trials", "sequences", "frames"]
    rows = [[d.second, str(d.trials), str(d.sequences), figure_text(d.difference_frames, 2)] for d in differences]
    return fitted_tables(header, rows)


def _risk_table(title: str, by_method: Mapping[str, Reliability]) -> str:
    header = [title, "stated risk", "maps", "mean stated risk %", "expected false", "false", "false %"]
    header += ["direction covered %", "rotation covered %"]
    rows = []
    for method, reliability in by_method.items():
        for name, one in reliability.named_bins():
            row = [method, name, str(one.maps), figure_text(one.mean_risk, 3, 100), figure_text(one.expected_false, 3)]
            row += [str(one.false), figure_text(one.false_rate, 1, 100)]
            coverages = (reliability.direction.rate, reliability.rotation.rate)
            rows.append([*row, *(figure_text(rate, 1, 100) if name == "all" else "" for rate in coverages)])
    return fitted_tables(header, rows, names=2)


def _command(arguments: argparse.Namespace) -> str:
    """Return a command that gives the same results. It names only the folders that the user typed."""
    words = ["slam-init", "compare", *arguments.sources]
    for option, default in _OPTIONS:
        value = getattr(arguments, option)
        if value != default:
            words += [f"--{option.replace('_', '-')}", str(value)]
    for method in arguments.method:
        words += ["--method", method]
    words += ["--audit"] if arguments.audit else []
    return shlex.join(words)
