"""What a command wrote to a folder."""

from __future__ import annotations

from pathlib import Path


def contents(folder: Path, *, hidden: bool = False) -> dict[str, bytes]:
    """The files of a folder by relative path; those of the program's hidden folder only where asked."""
    found = (path for path in folder.rglob("*") if path.is_file())
    names = ((path.relative_to(folder).as_posix(), path) for path in found)
    return {name: path.read_bytes() for name, path in names if hidden or not name.startswith(".slam-init/")}
