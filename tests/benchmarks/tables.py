"""Tables in markdown, and the rows of a comparison that they are made of."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import TypeAdapter

from slam_init.compare.rows import TrialRow


def read_journal(path: Path) -> list[TrialRow]:
    """The rows of ``trials.jsonl``, behind the line of the settings. The last row of a trial is valid."""
    reader = TypeAdapter(TrialRow)
    return [reader.validate_json(line, strict=True) for line in path.read_bytes().splitlines()[1:]]


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table in markdown: the first column is aligned left, the others right."""
    widths = [max(3, *(len(row[k]) for row in (header, *rows))) for k in range(len(header))]
    rule = [f":{'-' * (widths[0] - 1)}", *(f"{'-' * (width - 1)}:" for width in widths[1:])]

    def line(cells: Sequence[str]) -> str:
        aligned = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
        return f"| {' | '.join([cells[0].ljust(widths[0]), *aligned[1:]])} |"

    return "\n".join([line(header), f"| {' | '.join(rule)} |", *map(line, rows)])


def number(value: float | None, digits: int = 2) -> str:
    """Format a number for a cell of a table."""
    return "-" if value is None else f"{value:.{digits}f}"
