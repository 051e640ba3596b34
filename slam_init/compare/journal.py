"""``trials.jsonl``: each finished trial at once, so that a run that was killed goes on where it stopped."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from slam_init.errors import OutputError

__all__ = ["Journal", "Key"]

#: 2: ``kept_truth``, ``suspected_focal_factor``, and the options of the methods.
_SCHEMA = 2

#: Source, method and start.
Key = tuple[str, str, int]


class Journal:
    """Rows on disk, one a line, after a first line with the settings that they hold under.

    Rows are found by where they stand in the file: memory holds their keys and nothing else of them.

    Parameters
    ----------
    path : Path
        Continued where it exists; its last line is dropped where it is torn.
    settings : mapping
        What makes rows comparable, plain JSON types.

    Raises
    ------
    OutputError
        Where the file belongs to a comparison with other settings, is damaged, or cannot be written.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        self._path = path
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
        """Write a row; once this returns it survives the end of the process."""
        self._offsets[_key(row)] = self._file.seek(0, 2)
        self._write(row)

    def rows(self, wanted: Callable[[Key], bool] = lambda _: True) -> Iterator[dict[str, Any]]:
        """The rows that are wanted in order of source, method and start."""
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
        """Find the rows; return where the last whole line ends."""
        end = 0
        for number, line in enumerate(self._file):
            if not line.endswith(b"\n"):
                break  # torn: the process was killed while it wrote
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
            if found.get(name) != value and isinstance(value, Mapping):
                raise OutputError(f"{self._path} holds trials with other {name}: give another --out")
            if found.get(name) != value:
                raise OutputError(
                    f"{self._path} holds trials with {name} {found.get(name)!r}, not {value!r}: give another --out"
                )


def _key(row: Mapping[str, Any]) -> Key:
    return str(row["source"]), str(row["method"]), int(row["start"])
