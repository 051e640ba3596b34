"""Short texts of the project's objects: what ``print`` and a notebook show."""

from __future__ import annotations

from abc import abstractmethod
from html import escape

__all__ = ["Described"]


class Described:
    """Base of objects whose ``print`` is a title and a few facts, and whose notebook view is a small table.

    A class gives its facts by :meth:`_facts`. The text has at most six lines, so there are at most five facts.
    """

    @abstractmethod
    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        """The title, and at most five facts (name, text)."""

    def __str__(self) -> str:
        title, facts = self._facts()
        return "\n".join([title, *(f"  {name:<12}{text}" for name, text in facts)])

    def __repr__(self) -> str:
        title, _ = self._facts()
        return f"<{type(self).__name__}: {title}>"

    def _repr_html_(self) -> str:
        title, facts = self._facts()
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in facts)
        return f"<table><caption>{escape(title)}</caption>{rows}</table>"
