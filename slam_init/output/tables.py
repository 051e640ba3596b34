"""Tables in markdown."""

from __future__ import annotations

from collections.abc import Sequence


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table in markdown with aligned columns.

    * ``rows``: Cells of each row. Numbers must be formatted by the caller (:func:`number`); the cells are not changed.
    * Returns: The table, without a line break at the end. The first column is aligned left, the others right.
    """
    from tabulate import tabulate

    alignment = ["left", *["right"] * (len(header) - 1)]
    return tabulate(rows, header, tablefmt="pipe", disable_numparse=True, colalign=alignment)


def number(value: float | None, digits: int = 2) -> str:
    """Format a number for a cell of a table."""
    return "-" if value is None else f"{value:.{digits}f}"
