"""``trials.jsonl``: each trial is written as soon as it is finished, so that a killed run can be resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from slam_init.config import RENAMED_OPTIONS
from slam_init.errors import OutputError

__all__ = ["Journal", "Key"]

#: Version 2 added ``kept_truth``, ``suspected_focal_factor`` and the options of the methods.
_SCHEMA = 2

#: Label of the source, method, start frame.
Key = tuple[str, str, int]


class Journal:
    """A file with one row per line; the first line holds the settings under which the rows were computed.

    Memory holds only the key of each row and the position of the row in the file.

    Parameters
    ----------
    path : str or os.PathLike
        An existing file is continued. Its last line is removed if it is incomplete.
    settings : mapping
        Settings that must be equal for all rows, as plain JSON types.

    Raises
    ------
    OutputError
        If the file belongs to a comparison with other settings, is damaged, or cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], settings: Mapping[str, Any]) -> None:
        self._path = path = Path(path)
        self._offsets: dict[Key, int] = {}
        header = {"schema": _SCHEMA, **settings}
        try:
            self._file: IO[bytes] = path.open("r+b" if path.exists() else "w+b")
            end = self._read(header)
            self._file.truncate(end)
            self._file.seek(end)
            if end == 0:
                self._write(header)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}: give another --out") from error

    def __contains__(self, key: Key) -> bool:
        return key in self._offsets

    def __len__(self) -> int:
        return len(self._offsets)

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row; after this call the row survives the end of the process.

        Parameters
        ----------
        row : mapping
            With the keys ``source``, ``method`` and ``start``; plain JSON types.

        Raises
        ------
        OutputError
            If the row cannot be written.
        """
        self._offsets[_key(row)] = self._file.seek(0, 2)
        self._write(row)

    def rows(self, wanted: Callable[[Key], bool] = lambda _: True) -> Iterator[dict[str, Any]]:
        """Read rows back, sorted by source, method and start.

        Parameters
        ----------
        wanted : callable
            Takes the key of a row and returns whether the row is read; all rows by default.

        Yields
        ------
        dict
            A row.
        """
        for key in sorted(self._offsets):
            if wanted(key):
                self._file.seek(self._offsets[key])
                yield json.loads(self._file.readline())

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, content: Mapping[str, Any]) -> None:
        try:
            self._file.write(json.dumps(content, allow_nan=False).encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error.strerror or error}: make room") from error

    def _read(self, header: Mapping[str, Any]) -> int:
        """Find the rows; return the position of the end of the last complete line."""
        end = 0
        for number, line in enumerate(self._file):
            if not line.endswith(b"\n"):
                break  # incomplete: the process was killed while it wrote this line
            try:
                content = json.loads(line)
                if number == 0:
                    self._check(content, header)
                else:
                    self._offsets[_key(content)] = end
            except (ValueError, KeyError, TypeError, AttributeError):
                raise OutputError(f"{self._path}, line {number + 1} is damaged: give another --out") from None
            end += len(line)
        return end

    def _check(self, found: Mapping[str, Any], header: Mapping[str, Any]) -> None:
        if found.get("schema") != _SCHEMA:
            raise OutputError(f"{self._path} was written by another version of slam-init: give another --out")
        for name, value in header.items():
            if isinstance(value, Mapping):
                if _with_current_names(found.get(name), "") != value:
                    raise OutputError(f"{self._path} holds trials with other {name}: give another --out")
            elif found.get(name) != value:
                raise OutputError(
                    f"{self._path} holds trials with {name} {found.get(name)!r}, not {value!r}: give another --out"
                )


def _with_current_names(options: Any, prefix: str) -> Any:
    """Return options with their current names; a file of an older version can hold former names."""
    if not isinstance(options, Mapping):
        return options
    return {
        RENAMED_OPTIONS.get(prefix + name, name): _with_current_names(value, f"{name}.")
        for name, value in options.items()
    }


def _key(row: Mapping[str, Any]) -> Key:
    return str(row["source"]), str(row["method"]), int(row["start"])
