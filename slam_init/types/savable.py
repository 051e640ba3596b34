"""Objects with a method ``save``. :mod:`slam_init` sets the writer, so that the types import no writer of files."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import ClassVar


class Savable:
    """Base of what :meth:`save` writes."""

    #: Writes an object to a folder; set by :mod:`slam_init`.
    writer: ClassVar[Callable[[object, str | os.PathLike[str]], None]]

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the files that ``slam-init run`` writes for it; ``docs/reference/files.md`` lists them.

        A map is written as trajectory, points, COLMAP model, factor graph and ``handover.npz``. A result is written as
        its maps and ``summary.json``. Either all files are replaced, or none.

        * ``folder``: A folder that is new, empty, or was written by an earlier call or run.
        """
        Savable.writer(self, folder)
