"""Objects with a method ``save``. :mod:`slam_init` sets the writer, so that the types import no writer of files."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import ClassVar

#: Writes an object to a folder.
Writer = Callable[[object, str | os.PathLike[str]], None]


class Savable:
    """Base of what :meth:`save` writes."""

    _writer: ClassVar[Writer | None] = None

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the files that ``slam-init run`` writes for it; ``docs/reference/files.md`` lists them.

        A map is written as trajectory, points, COLMAP model, factor graph and ``handover.npz``. A result is written as
        its maps and ``summary.json``. Either all files are replaced, or none.

        * ``folder``: A folder that is new, empty, or was written by an earlier call or run.
        """
        assert Savable._writer is not None, "slam_init/__init__.py sets it"
        Savable._writer(self, folder)


def set_writer(writer: Writer) -> None:
    """Choose what :meth:`Savable.save` calls."""
    Savable._writer = staticmethod(writer)
