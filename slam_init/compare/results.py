"""The files ``results.csv``, ``summary.json`` and ``report.html``."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from slam_init.compare.extras import Digests, Extras
from slam_init.compare.rows import COLUMNS, TrialRow
from slam_init.compare.summary import ComparisonSummary, summary_of
from slam_init.compare.trial_table import TrialTable
from slam_init.output.folder import OutputFolder, output_error

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

_RESULTS, _SUMMARY, _REPORT = "results.csv", "summary.json", "report.html"


def publish_results(
    folder: OutputFolder, rows: Iterable[TrialRow], plan: Plan, command: str, extras: Extras, digests: Digests
) -> ComparisonSummary:
    """Write all result files: either all are replaced, or none. The rows are read once and are not kept in memory."""
    from slam_init.compare.report import report_html

    try:
        with (folder.staging / _RESULTS).open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            table = TrialTable.read(_write_rows(rows, writer.writerow))
        summary = summary_of(table, plan)
        texts = {
            _REPORT: report_html(table, plan, command),
            **extras.texts(table, plan, digests),
            _SUMMARY: json.dumps(summary.as_dict(), indent=2, allow_nan=False) + "\n",
        }
        for name, text in texts.items():
            # File names need not be valid Unicode.
            (folder.staging / name).write_bytes(text.encode("utf-8", "backslashreplace"))
    except OSError as error:
        raise output_error(folder.path, error) from error
    folder.publish([_RESULTS, *texts])
    return summary


def _write_rows(rows: Iterable[TrialRow], write: Callable[[Sequence[object]], object]) -> Iterator[TrialRow]:
    for row in rows:
        write([_cell(value) for value in row.values()])
        yield row


def _cell(value: str | int | float | bool | None) -> str | int | float | None:
    return str(value).lower() if isinstance(value, bool) else value
