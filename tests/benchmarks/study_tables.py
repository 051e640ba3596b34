"""The tables of the study: shares with Wilson intervals, and methods compared on the same trials."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from slam_init.compare.rows import TrialRow, read_journal
from slam_init.compare.statistics import Interval, restricted_mean, wilson
from slam_init.output.tables import markdown_table, number
from tests.benchmarks.study_parts import Cell

#: (source, method) -> row of the trial.
Rows = Mapping[tuple[str, str], TrialRow]


def read_rows(out: str | os.PathLike[str]) -> Rows:
    """Read the trials of a comparison from its folder; only those that start at frame 0."""
    rows = read_journal(Path(out) / "trials.jsonl")
    return {(row.source, row.method): row for row in rows if row.start == 0}


def moving_table(cells: Sequence[Cell], rows: Rows, methods: Sequence[str]) -> str:
    """Make the table of a part with a moving camera. The other methods are compared with the first one."""
    header = [
        "scene",
        "method",
        "trials",
        "correct %",
        "strict %",
        "false %",
        "none",
        "ambiguous: correct hypothesis kept",
    ]
    header += ["correct of solvable %", "frames to correct", f"difference to {methods[0]}"]
    lines = []
    together = Cell("all", tuple(text for cell in cells for text in cell.sources))
    for cell in (*cells, together):
        ours = _rows_of(cell, rows, methods[0])
        solved = [any(rows[source, method].outcome == "correct" for method in methods) for source in cell.sources]
        for method in methods:
            found = _rows_of(cell, rows, method)
            correct = [row.outcome == "correct" for row in found]
            frames = frames_to_correct(found)
            difference = [a - b for a, b in zip(frames, frames_to_correct(ours), strict=True)]
            ambiguous = [row.kept_truth for row in found if row.kept_truth is not None]
            lines.append(
                [
                    cell.name if method == methods[0] else "",
                    method,
                    str(len(found)),
                    _share(correct),
                    number(
                        100 * sum(c and bool(row.strict) for c, row in zip(correct, found, strict=True)) / len(found),
                        1,
                    ),
                    _share([row.outcome == "false" for row in found]),
                    _none_text(found),
                    f"{sum(ambiguous)} of {len(ambiguous)}" if ambiguous else "-",
                    _share([c for c, by_any in zip(correct, solved, strict=True) if by_any]),
                    number(float(np.mean(frames)), 2),
                    "-" if method == methods[0] else interval_text(_mean(difference), 1.0, 2),
                ]
            )
    return markdown_table(header, lines)


def static_table(cells: Sequence[Cell], rows: Rows, methods: Sequence[str]) -> str:
    """Make the table of the part without translation."""
    header = ["scene", "method", "trials", "false %", "none", "expected reason %"]
    header += ["focal error suspected %", "focal error reported %"]
    lines = []
    for cell in cells:
        for method in methods:
            found = _rows_of(cell, rows, method)
            lines.append(
                [
                    cell.name if method == methods[0] else "",
                    method,
                    str(len(found)),
                    _share([row.outcome == "false" for row in found]),
                    _none_text(found),
                    _share([bool(row.reason_right) for row in found]),
                    _share([row.suspected_focal_factor is not None for row in found]),
                    _share([row.reported_focal_factor is not None for row in found]),
                ]
            )
    return markdown_table(header, lines)


def frames_to_correct(rows: Sequence[TrialRow]) -> list[float]:
    """Return the frames until a correct map; the limit for a trial without one."""
    return [
        float(row.frames_to_accept)
        if row.outcome == "correct" and row.frames_to_accept is not None
        else float(row.frames_limit)
        for row in rows
    ]


def interval_text(interval: Interval, scale: float, digits: int) -> str:
    """Format an estimate with its interval; a hyphen if there are no observations."""
    if interval.value != interval.value:
        return "-"
    value, low, high = (scale * x for x in (interval.value, interval.low, interval.high))
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _rows_of(cell: Cell, rows: Rows, method: str) -> list[TrialRow]:
    return [rows[source, method] for source in cell.sources]


def _share(holds: Sequence[bool]) -> str:
    return interval_text(wilson(sum(holds), len(holds)), 100.0, 1)


def _mean(values: Sequence[float]) -> Interval:
    """Return the mean with its normal interval."""
    return restricted_mean(values, [float("inf")] * len(values))


def _none_text(rows: Sequence[TrialRow]) -> str:
    """Return the number of trials without a map, with their reasons; errors are listed as ``error``."""
    none = Counter(str(row.reason) for row in rows if row.outcome == "none")
    errors = sum(row.outcome == "error" for row in rows)
    parts = [f"{count} {reason}" for reason, count in sorted(none.items(), key=lambda item: (-item[1], item[0]))]
    parts += [f"{errors} error"] if errors else []
    return f"{none.total() + errors} ({', '.join(parts)})" if parts else "0"
