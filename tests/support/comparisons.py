"""A small comparison for the tests of :mod:`slam_init.compare`, and how to read its results."""

from __future__ import annotations

import csv
from pathlib import Path

SOURCES = ("points:room?views=5&seed=1", "points:wall?views=5&seed=2", "points:rotation?views=5&seed=3")
METHODS = ("stella", "essential-8pt", "failing_methods:Raises")


def rows_of(out: Path) -> list[dict[str, str]]:
    """The rows of ``results.csv`` without the columns that differ from run to run."""
    with (out / "results.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if not k.endswith(("_ms", "_mb"))} for row in csv.DictReader(file)]
