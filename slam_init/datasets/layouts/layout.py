"""What a layout is: a way to find the files of a kind of folder, and a way to open it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slam_init.datasets.timed import TimedSource


@dataclass(frozen=True)
class Layout:
    """A kind of folder or file."""

    #: What :func:`slam_init.datasets.opening.detect_kind` returns.
    kind: str
    #: The files that tell it, and its name in brackets, for the message where nothing fits.
    looked_for: str
    #: Finds the files that a path of this kind has; None or False for another path. It reads no large file.
    find: Callable[[Path], Any]
    #: Opens a path, with what was found.
    open: Callable[[Path, Any], TimedSource]


def file_of(*names: str) -> Callable[[Path], Path | None]:
    """Make the search for the first of some files in a folder."""
    return lambda folder: next((folder / name for name in names if (folder / name).is_file()), None)
