"""Short texts of objects for ``print`` and for a notebook."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from html import escape


def aligned(title: str, facts: Sequence[tuple[str, str]]) -> str:
    """A title, and below it a line for each fact (name, text)."""
    width = max([12, *(len(name) + 2 for name, _ in facts)])
    return "\n".join([title, *(f"  {name:<{width}}{text}" for name, text in facts)])


class Described:
    """Base of objects that ``print`` as a title with a few facts, and that a notebook shows as a small table.

    A class implements :meth:`_facts`.
    """

    @abstractmethod
    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        """Return the title, and a few facts (name, text)."""

    def __str__(self) -> str:
        return aligned(*self._facts())

    def __repr__(self) -> str:
        title, _ = self._facts()
        return f"<{type(self).__name__}: {title}>"

    def _repr_html_(self) -> str:
        title, facts = self._facts()
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in facts)
        return f"<table><caption>{escape(title)}</caption>{rows}</table>"
