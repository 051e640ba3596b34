"""Tables in markdown, formatted as those of :mod:`quest.benchmarks.tables`."""

from __future__ import annotations

from quest.benchmarks.tables import markdown_table, number

__all__ = ["markdown_table", "number"]
