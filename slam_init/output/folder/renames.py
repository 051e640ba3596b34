"""The renames that replace earlier results by new ones, under a journal; see :mod:`slam_init.output.folder`."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from slam_init.errors import OutputError
from slam_init.output.folder.files import is_safe_name, output_error, replace_synced, sync, under
from slam_init.output.folder.marker import HOME, Marker, write_marker

NEW, OLD = "new", "old"
_JOURNAL = "journal.json"


@dataclass(frozen=True)
class Renames:
    """A step from earlier results to new ones."""

    #: Files that are moved from ``new`` to their places, in this order. The last one says that all are there: it is
    #: the first that is taken away, and the last that is put.
    put: tuple[str, ...]
    #: Files that are removed.
    remove: tuple[str, ...]
    #: The marker after the step.
    marker: Marker

    def perform(self, out: Path) -> None:
        """Replace the results: all of them, or none."""
        try:
            self._prepare(out)
            replace_synced(out / HOME / _JOURNAL, self._text())
        except OSError as error:
            raise output_error(out, error) from error
        self.complete(out)

    def complete(self, out: Path) -> None:
        """Perform the renames that are left; undo all of them if one fails."""
        try:
            self._move(out)
            write_marker(out, self.marker)
        except OSError as error:
            with suppress(OSError):  # else the journal stays, and the next command tries again
                self._undo(out)
            raise output_error(out, error) from error
        with suppress(OSError):  # the results are in their places; the next command removes the journal
            self._end(out)

    def _prepare(self, out: Path) -> None:
        """Sync the new files, and create all folders, so that a full disk is noticed before the first rename."""
        new, old = out / HOME / NEW, out / HOME / OLD
        folders: set[Path] = set()
        for name in self.put:
            sync(new / name)
            under(out, name).parent.mkdir(parents=True, exist_ok=True)
            folders |= {(new / name).parent, (out / name).parent}
        for name in (*self.put, *self.remove):
            (old / name).parent.mkdir(parents=True, exist_ok=True)
            folders.add((old / name).parent)
        for folder in sorted(folders):
            sync(folder)

    def _move(self, out: Path) -> None:
        new, old = out / HOME / NEW, out / HOME / OLD
        for name in reversed(self.put):
            if os.path.lexists(new / name) and os.path.lexists(under(out, name)):
                (out / name).replace(old / name)
        for name in self.remove:
            if os.path.lexists(under(out, name)) and not os.path.lexists(old / name):
                (out / name).replace(old / name)
        for name in self.put:
            if os.path.lexists(new / name):
                (new / name).replace(under(out, name))
        for folder in sorted({(out / name).parent for name in (*self.put, *self.remove)}):
            if folder.is_dir():
                sync(folder)

    def _undo(self, out: Path) -> None:
        new, old = out / HOME / NEW, out / HOME / OLD
        for name in reversed(self.put):
            if not os.path.lexists(new / name) and os.path.lexists(out / name):
                (out / name).replace(new / name)
        for name in (*self.remove, *self.put):
            if os.path.lexists(old / name):
                (old / name).replace(out / name)
        self._end(out)

    def _end(self, out: Path) -> None:
        (out / HOME / _JOURNAL).unlink(missing_ok=True)
        sync(out / HOME)
        for name in self.remove:
            for folder in PurePosixPath(name).parents[:-1]:
                with suppress(OSError):  # it holds other files
                    (out / folder).rmdir()

    def _text(self) -> bytes:
        content = {
            "put": self.put,
            "remove": self.remove,
            "command": self.marker.command,
            "version": self.marker.version,
            "files": sorted(self.marker.files),
        }
        return json.dumps(content).encode() + b"\n"


def pending(out: Path) -> Renames | None:
    """Return the renames that a killed command has begun."""
    path = out / HOME / _JOURNAL
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_bytes())
        put, remove, files = (tuple(content[key]) for key in ("put", "remove", "files"))
        if not all(is_safe_name(name, HOME) for name in (*put, *remove, *files)):
            raise ValueError("a name outside the folder")
        return Renames(put, remove, Marker(str(content["command"]), str(content["version"]), frozenset(files)))
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is damaged: remove {out}, or give another --out") from None
