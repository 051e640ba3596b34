"""The types in which a user may give a path: str, pathlib.Path, and any other object with ``__fspath__``."""

from __future__ import annotations

from pathlib import Path


class OtherPath:
    """A path-like object that is neither a str nor a Path."""

    def __init__(self, path: str | Path) -> None:
        self._path = str(path)

    def __fspath__(self) -> str:
        return self._path


PATH_TYPES = [str, Path, OtherPath]
