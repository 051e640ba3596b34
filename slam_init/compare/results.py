"""What a comparison leaves: ``results.csv``, ``summary.json``, ``report.html``; each whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slam_init.compare.aggregate import TrialTable, summary_of
from slam_init.compare.trials import COLUMNS
from slam_init.errors import OutputError

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

__all__ = ["remove_results", "write_results"]

_RESULTS, _SUMMARY, _REPORT = "results.csv", "summary.json", "report.html"
#: 2: ambiguous planes and whether the kept maps hold the truth; suspected calibrations.
_SCHEMA = 2


def remove_results(out: Path) -> None:
    """Take away what an earlier run left: until this one ends there are no results.

    Raises
    ------
    OutputError
        Where that is not allowed.
    """
    try:
        for name in (_RESULTS, _SUMMARY, _REPORT):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to --out {out}: {error.strerror or error}: give another folder") from error


def write_results(out: Path, rows: Iterable[Mapping[str, Any]], plan: Plan, command: str) -> dict[str, Any]:
    """Write all files from the rows, which are read once and not kept.

    Parameters
    ----------
    out : Path
    rows : iterable of mapping
        In order of source, method and start.
    plan : Plan
    command : str
        What the user typed, for the report.

    Returns
    -------
    dict
        The content of ``summary.json``.

    Raises
    ------
    OutputError
        Where a file cannot be written.
    """
    from slam_init.compare.report import report_html

    written: dict[str, Path] = {}
    try:
        written[_RESULTS], file = _beside(out / _RESULTS)
        with file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            table = TrialTable.of(_copied(rows, writer))
        summary = {
            "schema": _SCHEMA,
            "seed": plan.settings.seed,
            "every": plan.every,
            "limit_frames": plan.settings.limit_frames,
            "limit_s": plan.settings.limit_s,
            "trials": len(table),
            "methods": list(plan.methods),
            "sources": [source.label for source in plan.sources],
            **summary_of(table, plan.methods),
        }
        texts = {
            _SUMMARY: json.dumps(summary, indent=2, allow_nan=False) + "\n",
            _REPORT: report_html(table, plan, command),
        }
        for name, text in texts.items():
            written[name], file = _beside(out / name)
            with file:
                file.write(text)
        for name, temporary in written.items():
            temporary.replace(out / name)
    except OSError as error:
        raise OutputError(f"cannot write to --out {out}: {error.strerror or error}: make room") from error
    finally:  # also after an interrupt: leave no debris
        for temporary in written.values():
            temporary.unlink(missing_ok=True)
    return summary


def _copied(rows: Iterable[Mapping[str, Any]], writer: Any) -> Iterator[Mapping[str, Any]]:
    for row in rows:
        writer.writerow([_cell(row.get(name)) for name in COLUMNS])
        yield row


def _cell(value: Any) -> Any:
    return str(value).lower() if isinstance(value, bool) else value


def _beside(path: Path) -> tuple[Path, io.TextIOWrapper]:
    """A hidden file beside the one that it is to replace, readable as any other file of the user."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    umask = os.umask(0)
    os.umask(umask)
    os.fchmod(handle, 0o666 & ~umask)
    # Names of files may be no Unicode.
    return Path(name), os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace", newline="")
