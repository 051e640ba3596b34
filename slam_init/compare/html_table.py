"""The frame of an HTML table: a caption for screen readers, the scope of each heading, a box that scrolls."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


def html_table(caption: str, headings: Iterable[str], rows: Iterable[str], kind: str = "") -> str:
    """Make a table."""
    head = "".join(f'<th scope="col">{heading}</th>' for heading in headings)
    of_kind = f' class="{kind}"' if kind else ""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table{of_kind}>'
        f"<caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def row_heading(text: str, rows: int = 1) -> str:
    """Make the heading of a row."""
    span = f' rowspan="{rows}"' if rows > 1 else ""
    return f'<th scope="row{"group" if rows > 1 else ""}"{span}>{escape(text)}</th>'
