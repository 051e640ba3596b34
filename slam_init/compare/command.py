"""Runs ``slam-init compare`` after the command line has checked the options."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from slam_init.compare.aggregate import Figures
from slam_init.compare.isolation import check_method
from slam_init.compare.plan import Plan
from slam_init.compare.reliability import Reliability
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources, grid_sources
from slam_init.compare.statistics import Interval
from slam_init.compare.summary import ComparisonSummary, six_digits
from slam_init.compare.trial_table import LEVELS, PARTS
from slam_init.compare.trials import Settings
from slam_init.compare.wait import WaitDifference
from slam_init.config import REALTIME_WORK, Config
from slam_init.datasets.views import SourceView
from slam_init.errors import ConfigError
from slam_init.methods.external_command import is_external, method_label
from slam_init.output.tables import fitted_tables, number

#: The options on which the results depend, and their defaults.
_OPTIONS = (
    ("methods", None), ("every", 10), ("min_left", 3), ("grid", 0), ("limit_frames", 150), ("seed", 0),
    ("use_every", 1), ("fps", None), ("mask", None),
)  # fmt: skip


def run_command(arguments: argparse.Namespace, out: str | os.PathLike[str], *, progress: bool) -> str:
    """Run a comparison."""
    methods = chosen_methods(arguments.methods, arguments.method)
    texts = [*arguments.sources, *grid_sources(arguments.grid, arguments.seed)]
    view = SourceView(arguments.use_every, arguments.fps, arguments.mask)
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
            config=Config(work_per_frame=REALTIME_WORK if arguments.realtime else None),
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
    told = "".join(f"{line}\n" for line in not_applicable_lines(plan))
    return f"{main_table(summary)}\n\n{told}report: {Path(out) / 'report.html'}\n"


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
            table = _static_table if part.endswith("static") else _moving_table
            tables.append(table(title, summary.parts[part]))
        if summary.waits.get(part):
            tables.append(_wait_table(summary.waits[part]))
    tables += [_risk_table(LEVELS[level], by_method) for level, by_method in summary.reliability.items()]
    return "\n\n".join(tables)


def _moving_table(title: str, figures: Mapping[str, Figures]) -> str:
    header = [
        title,
        "trials",
        "correct %",
        "strict %",
        "false %",
        "none",
        "plane: right map kept %",
        "error",
    ]
    header += ["wait (frames)", "rotation (deg)", "direction (deg)", "survival", "frame (ms)"]
    rows = []
    for method, f in figures.items():
        rows.append(
            [
                method,
                str(f.trials),
                _percent(f.correct_rate),
                number(100 * f.strict / f.trials if f.trials else None, 1),
                _percent(f.false_rate),
                str(f.none),
                _percent(f.kept_truth_rate),
                str(f.error),
                _interval(f.wait),
                _number(f.medians["rotation_error_deg"]),
                _number(f.medians["direction_error_deg"]),
                _number(f.medians["survival"]),
                _number(f.times["frame_median_ms"], 1),
            ]
        )
    return fitted_tables(header, rows)


def _static_table(title: str, figures: Mapping[str, Figures]) -> str:
    header = [title, "trials", "false %", "none", "error", "expected reason %"]
    header += ["focal error suspected %", "focal error reported %"]
    rows = [
        [
            method,
            str(f.trials),
            _percent(f.false_rate),
            str(f.none),
            str(f.error),
            _percent(f.reason_accuracy),
            _percent(f.suspicion_rate),
            _percent(f.report_rate),
        ]
        for method, f in figures.items()
    ]
    return fitted_tables(header, rows)


def _wait_table(differences: Sequence[WaitDifference]) -> str:
    header = [f"wait of {differences[0].first} minus that of", "trials", "sequences", "frames"]
    rows = [[d.second, str(d.trials), str(d.sequences), _interval(d.difference_frames)] for d in differences]
    return fitted_tables(header, rows)


def _risk_table(title: str, by_method: Mapping[str, Reliability]) -> str:
    header = [title, "stated risk", "maps", "mean stated risk %", "expected false", "false", "false %"]
    header += ["direction covered %", "rotation covered %"]
    rows = []
    for method, reliability in by_method.items():
        for one in (*reliability.bins, reliability.total):
            if one.maps:
                is_total = one is reliability.total
                coverages = (reliability.direction, reliability.rotation)
                rows.append(
                    [
                        method,
                        "all" if is_total else f"{one.low:g} to {one.high:g}",
                        str(one.maps),
                        _number(100 * one.mean_risk, 3),
                        _number(one.expected_false, 3),
                        str(one.false),
                        _percent(one.false_rate),
                        *(_percent(coverage.rate) if is_total else "" for coverage in coverages),
                    ]
                )
    return fitted_tables(header, rows, names=2)


def _interval(interval: Interval) -> str:
    """Return a figure with its 95 % interval; without it if a single sequence gives none."""
    value, low, high = (six_digits(end) for end in (interval.value, interval.low, interval.high))
    ends = "" if low is None or high is None else f" [{low:.2f}, {high:.2f}]"
    return f"{number(value, 2)}{ends}"


def _number(value: float | None, digits: int = 2) -> str:
    return number(six_digits(value), digits)


def _percent(interval: Interval) -> str:
    value, low, high = (six_digits(end) for end in (interval.value, interval.low, interval.high))
    if value is None or low is None or high is None:
        return "-"
    return f"{100 * value:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def _command(arguments: argparse.Namespace) -> str:
    """Return a command that gives the same results. It names only the folders that the user typed."""
    words = ["slam-init", "compare", *arguments.sources]
    for option, default in _OPTIONS:
        value = getattr(arguments, option)
        if value != default:
            words += [f"--{option.replace('_', '-')}", str(value)]
    for method in arguments.method:
        words += ["--method", method]
    return shlex.join(words)
