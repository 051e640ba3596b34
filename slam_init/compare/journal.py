"""``trials.jsonl``: each trial is written as soon as it is finished, so that a killed run can be resumed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO

from slam_init.compare.rows import Key, TrialRow, parse_row, row_text
from slam_init.errors import OutputError
from slam_init.output.plain_json import Json

#: Version 2 added ``kept_truth``, ``suspected_focal_factor`` and the options of the methods.
_SCHEMA = 2
#: Interval of the syncs to the disk.
_SYNC_S = 1.0


class Journal:
    """A file with one row per line; the first line holds the settings under which the rows were computed.

    Memory holds only the key of each row and the position of the row in the file.

    * ``path``: An existing file is continued. Its last line is removed if it is incomplete.
    * ``settings``: Settings that must be equal for all rows.
    * ``is_current``: Takes a row and returns whether it is valid; all rows by default. Other rows are passed over, so
      that their trials are run again. If a trial has several rows, the last one is valid.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        settings: Mapping[str, Json],
        is_current: Callable[[TrialRow], bool] = lambda _: True,
    ) -> None:
        self._path = path = Path(path)
        self._is_current = is_current
        self._offsets: dict[Key, int] = {}
        self._synced_s = 0.0
        header: dict[str, Json] = {"schema": _SCHEMA, **settings}
        try:
            self._file: IO[bytes] = path.open("r+b" if path.exists() else "w+b")
            end = self._read(header)
            self._file.truncate(end)
            self._file.seek(end)
            if end == 0:
                self._write(json.dumps(header, allow_nan=False))
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}: give another --out") from error

    def __contains__(self, key: Key) -> bool:
        return key in self._offsets

    def __len__(self) -> int:
        return len(self._offsets)

    def append(self, row: TrialRow) -> None:
        """Write a row; after this call the row survives the end of the process, and a second later a power loss."""
        self._offsets[row.key] = self._file.seek(0, 2)
        self._write(row_text(row))

    def rows(self, wanted: Callable[[Key], bool] = lambda _: True) -> Iterator[TrialRow]:
        """Read rows back, sorted by source, method and start.

        * ``wanted``: Takes the key of a row and returns whether the row is read; all rows by default.
        """
        for key in sorted(self._offsets):
            if wanted(key):
                self._file.seek(self._offsets[key])
                yield parse_row(self._file.readline())

    def close(self) -> None:
        """Close the file."""
        # After a failed write, the rest of the buffer fails again; its error is raised already.
        with suppress(OSError):
            os.fsync(self._file.fileno())
            self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, line: str) -> None:
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
            # A sync takes milliseconds, and many trials take no longer.
            if time.monotonic() - self._synced_s > _SYNC_S:
                os.fsync(self._file.fileno())
                self._synced_s = time.monotonic()
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error.strerror or error}: make room") from error

    def _read(self, header: Mapping[str, Json]) -> int:
        """Find the rows; return the position of the end of the last complete line."""
        end = 0
        for number, line in enumerate(self._file):
            # Incomplete: the process was killed while it wrote this line. After a power loss the line may be zeros.
            if not line.endswith(b"\n") or line.startswith(b"\0"):
                break
            try:
                if number == 0:
                    self._check(_parse_settings(line), header)
                elif self._is_current(row := parse_row(line)):
                    self._offsets[row.key] = end
                else:
                    self._offsets.pop(row.key, None)
            except ValueError:
                raise OutputError(f"{self._path}, line {number + 1} is damaged: give another --out") from None
            end += len(line)
        return end

    def _check(self, found: Mapping[str, Json], header: Mapping[str, Json]) -> None:
        if found.get("schema") != _SCHEMA:
            raise OutputError(f"{self._path} was written by another version of slam-init: give another --out")
        for name, value in header.items():
            if found.get(name) == value:
                continue
            if isinstance(value, dict):
                raise OutputError(f"{self._path} holds trials with other {name}: give another --out")
            raise OutputError(
                f"{self._path} holds trials with {name} {found.get(name)!r}, not {value!r}: give another --out"
            )


def read_journal(path: str | os.PathLike[str]) -> Iterator[TrialRow]:
    """Read the rows of a finished comparison in the order of the file. The last row of a trial is valid."""
    with Path(path).open("rb") as file:
        next(file)  # the settings
        for number, line in enumerate(file, 2):
            try:
                yield parse_row(line)
            except ValueError:
                raise OutputError(f"{path}, line {number} is damaged: run the comparison again") from None


def _parse_settings(line: bytes) -> dict[str, Json]:
    content = json.loads(line)
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    return content
