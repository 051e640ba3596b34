"""The files ``results.csv``, ``summary.json`` and ``report.html``. Each is written completely or not at all."""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from slam_init.compare.rows import COLUMNS, TrialRow
from slam_init.compare.summary import ComparisonSummary, summary_of
from slam_init.compare.trial_table import TrialTable
from slam_init.errors import OutputError

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

__all__ = ["remove_results", "write_results"]

_RESULTS, _SUMMARY, _REPORT = "results.csv", "summary.json", "report.html"


def remove_results(out: str | os.PathLike[str]) -> None:
    """Remove the result files of an earlier run, so that no old results are there while a new run is unfinished.

    Parameters
    ----------
    out : str or os.PathLike
        Folder of the comparison. ``trials.jsonl`` is not removed.

    Raises
    ------
    OutputError
        If a file cannot be removed.
    """
    try:
        for name in (_RESULTS, _SUMMARY, _REPORT):
            (Path(out) / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to --out {out}: {error.strerror or error}: give another folder") from error


def write_results(out: str | os.PathLike[str], rows: Iterable[TrialRow], plan: Plan, command: str) -> ComparisonSummary:
    """Write all result files. The rows are read once and are not kept in memory.

    Parameters
    ----------
    out : str or os.PathLike
        Folder of the comparison.
    rows : iterable of TrialRow
        Sorted by source, method and start.
    plan : Plan
    command : str
        The command line that the report shows; empty for none.

    Returns
    -------
    ComparisonSummary
        The content of ``summary.json``.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    out = Path(out)
    from slam_init.compare.report import report_html

    written: dict[str, Path] = {}
    try:
        written[_RESULTS], file = _temporary_file(out / _RESULTS)
        with file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            table = TrialTable.of(_write_rows(rows, writer.writerow))
        summary = summary_of(table, plan)
        texts = {
            _SUMMARY: json.dumps(summary.as_dict(), indent=2, allow_nan=False) + "\n",
            _REPORT: report_html(table, plan, command),
        }
        for name, text in texts.items():
            written[name], file = _temporary_file(out / name)
            with file:
                file.write(text)
        for name, temporary in written.items():
            temporary.replace(out / name)
    except OSError as error:
        raise OutputError(f"cannot write to --out {out}: {error.strerror or error}: make room") from error
    finally:  # after an interrupt as well: leave no temporary files
        for temporary in written.values():
            temporary.unlink(missing_ok=True)
    return summary


def _write_rows(rows: Iterable[TrialRow], write: Callable[[Sequence[object]], object]) -> Iterator[TrialRow]:
    for row in rows:
        write([_cell(value) for value in row.values()])
        yield row


def _cell(value: str | int | float | bool | None) -> str | int | float | None:
    return str(value).lower() if isinstance(value, bool) else value


def _temporary_file(path: Path) -> tuple[Path, io.TextIOWrapper]:
    """Open a hidden file in the folder of ``path``, with the default permissions of the user."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    umask = os.umask(0)
    os.umask(umask)
    os.fchmod(handle, 0o666 & ~umask)
    # File names need not be valid Unicode.
    return Path(name), os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace", newline="")
