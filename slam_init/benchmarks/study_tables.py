"""The tables of the study: shares with Wilson intervals, and methods compared trial by trial."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.benchmarks.study_parts import NOISES_PX, Cell, grid_name
from slam_init.compare.sources import GRID
from slam_init.compare.statistics import Interval, restricted_mean, wilson
from slam_init.output.tables import markdown_table, number

__all__ = [
    "Rows",
    "counts_text",
    "frames_to_correct",
    "grid_table",
    "interval_text",
    "moving_table",
    "read_rows",
    "still_table",
]

#: Source and method -> the row of the trial.
Rows = Mapping[tuple[str, str], Mapping[str, Any]]


def read_rows(out: Path) -> Rows:
    """The trials that a comparison left in a folder, one start a source."""
    with (out / "trials.jsonl").open(encoding="utf-8") as file:
        next(file)  # the settings
        rows = [json.loads(line) for line in file]
    return {(row["source"], row["method"]): row for row in rows if row["start"] == 0}


def moving_table(cells: Sequence[Cell], rows: Rows, methods: Sequence[str]) -> str:
    """Cells down, and within each the methods; the first method is the one that the others are compared with."""
    header = ["scene", "method", "trials", "correct %", "strict %", "false %", "none", "of ambiguous: truth kept"]
    header += ["correct of those any solves %", "frames to correct", f"more than {methods[0]}"]
    lines = []
    together = Cell("all", tuple(text for cell in cells for text in cell.sources))
    for cell in (*cells, together):
        ours = _of(cell, rows, methods[0])
        solved = [any(rows[source, method]["outcome"] == "correct" for method in methods) for source in cell.sources]
        for method in methods:
            found = _of(cell, rows, method)
            correct = [row["outcome"] == "correct" for row in found]
            frames = frames_to_correct(found)
            more = [a - b for a, b in zip(frames, frames_to_correct(ours), strict=True)]
            undecided = [row["kept_truth"] for row in found if row["kept_truth"] is not None]
            lines.append(
                [
                    cell.name if method == methods[0] else "",
                    method,
                    str(len(found)),
                    _share(correct),
                    number(
                        100
                        * sum(c and bool(row["strict"]) for c, row in zip(correct, found, strict=True))
                        / len(found),
                        1,
                    ),
                    _share([row["outcome"] == "false" for row in found]),
                    _none(found),
                    f"{sum(undecided)} of {len(undecided)}" if undecided else "-",
                    _share([c for c, any_ in zip(correct, solved, strict=True) if any_]),
                    number(float(np.mean(frames)), 2),
                    "-" if method == methods[0] else interval_text(_mean(more), 1.0, 2),
                ]
            )
    return markdown_table(header, lines)


def still_table(cells: Sequence[Cell], rows: Rows, methods: Sequence[str]) -> str:
    """Cells down, and within each the methods."""
    header = ["scene", "method", "trials", "false %", "none", "right reason %", "suspected %", "told %"]
    lines = []
    for cell in cells:
        for method in methods:
            found = _of(cell, rows, method)
            lines.append(
                [
                    cell.name if method == methods[0] else "",
                    method,
                    str(len(found)),
                    _share([row["outcome"] == "false" for row in found]),
                    _none(found),
                    _share([bool(row["reason_right"]) for row in found]),
                    _share([row["suspected_focal_factor"] is not None for row in found]),
                    _share([row["reported_focal_factor"] is not None for row in found]),
                ]
            )
    return markdown_table(header, lines)


def grid_table(cells: Sequence[Cell], rows: Rows, method: str, solvable: Container[str] | None) -> str:
    """Noise against baseline: correct / false / none of a method, and how many are solvable; a table a scene."""
    by_name = {cell.name: cell for cell in cells}

    def told(cell: Cell) -> str:
        counts = counts_text(_of(cell, rows, method))
        return counts if solvable is None else f"{counts} ({sum(text in solvable for text in cell.sources)})"

    tables = []
    for scene in dict.fromkeys(name.partition(",")[0] for name in by_name):
        lines = [
            [
                f"{noise_px:g} px",
                *(told(by_name[grid_name(scene, noise_px, baseline)]) for baseline in GRID["baseline"]),
            ]
            for noise_px in NOISES_PX
        ]
        tables.append(markdown_table([scene, *(f"{baseline:g}" for baseline in GRID["baseline"])], lines))
    return "\n\n".join(tables)


def counts_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Correct / false / none, errors among the last."""
    counts = Counter(row["outcome"] for row in rows)
    return f"{counts['correct']} / {counts['false']} / {counts['none'] + counts['error']}"


def frames_to_correct(rows: Sequence[Mapping[str, Any]]) -> list[float]:
    """Frames until a correct map, the limit where there is none."""
    return [float(row["frames_to_accept"] if row["outcome"] == "correct" else row["frames_limit"]) for row in rows]


def interval_text(interval: Interval, scale: float, digits: int) -> str:
    """An estimate with its interval; a dash where nothing was observed."""
    if interval.value != interval.value:
        return "-"
    value, low, high = (scale * x for x in (interval.value, interval.low, interval.high))
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _of(cell: Cell, rows: Rows, method: str) -> list[Mapping[str, Any]]:
    return [rows[source, method] for source in cell.sources]


def _share(holds: Sequence[bool]) -> str:
    return interval_text(wilson(sum(holds), len(holds)), 100.0, 1)


def _mean(values: Sequence[float]) -> Interval:
    """With the normal interval of a mean."""
    return restricted_mean(values, [float("inf")] * len(values))


def _none(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many have no map, and the reasons; errors are told as such."""
    none = Counter(str(row["reason"]) for row in rows if row["outcome"] == "none")
    errors = sum(row["outcome"] == "error" for row in rows)
    told = [f"{count} {reason}" for reason, count in sorted(none.items(), key=lambda item: (-item[1], item[0]))]
    told += [f"{errors} error"] if errors else []
    return f"{none.total() + errors} ({', '.join(told)})" if told else "0"
