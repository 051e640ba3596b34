"""Tables in markdown."""

from __future__ import annotations

from collections.abc import Sequence

#: The width that terminals have at least, where somebody looks at figures. A wider table breaks its lines.
TERMINAL_WIDTH = 120


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table in markdown with aligned columns.

    * ``rows``: Cells of each row, which are not changed.
    * Returns: The table, without a line break at the end. The first column is aligned left, the others right.
    """
    widths = [max([len(heading) + 2, *(len(row[k]) for row in rows)]) for k, heading in enumerate(header)]
    lines = [
        [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        for row in (header, *rows)
    ]
    rule = "|".join([f":{'-' * (widths[0] + 1)}", *(f"{'-' * (width + 1)}:" for width in widths[1:])])
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([head, f"|{rule}|", *body])


def fitted_tables(header: Sequence[str], rows: Sequence[Sequence[str]], names: int = 1) -> str:
    """Format a table for a terminal: in several tables one below the other where it is wider.

    * ``names``: The first columns, which name a row; each table begins with them.
    * Returns: The tables in markdown. A column without a value in any row is left out.
    """
    cells = [header, *rows]
    widths = [max(3, *(len(row[k]) for row in cells)) + 3 for k in range(len(header))]
    known = [k for k in range(names, len(header)) if any(row[k] not in ("", "-") for row in rows)]
    parts: list[list[int]] = []
    for k in known or range(names, len(header)):
        if not parts or 1 + sum(widths[i] for i in (*range(names), *parts[-1], k)) > TERMINAL_WIDTH:
            parts.append([])
        parts[-1].append(k)
    tables = []
    for part in parts:
        first, *others = ([row[k] for k in (*range(names), *part)] for row in cells)
        tables.append(markdown_table(first, others))
    return "\n\n".join(tables)
