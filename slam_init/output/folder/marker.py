"""The marker of an output folder (which command wrote it, and which files), and the renames of its files.

Files survive a power loss, and names stay inside their folder; see :mod:`slam_init.output.folder`.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
from typing import Literal

from slam_init.errors import OutputError
from slam_init.output.plain_json import parsed

#: Some file systems have no sync of a file or folder.
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def output_error(out: Path, error: OSError) -> OutputError:
    """Return the error of a folder that cannot be written."""
    return OutputError(
        f"cannot write to --out {out}: {error.strerror or error}: {remedy(error)}, or give another --out"
    )


def remedy(error: BaseException) -> str:
    """Return what a user can do about a file that cannot be written."""
    full = isinstance(error, OSError) and error.errno in _NO_SPACE
    return "make room" if full else "give a folder that you can write to"


def sync(path: Path) -> None:
    """Write the content of a file, or the entries of a folder, to the disk."""
    if sys.platform == "win32" and path.is_dir():
        return  # Windows cannot open folders
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
    finally:
        os.close(handle)


def replace_synced(path: Path, content: bytes) -> None:
    """Write a file completely or not at all, also if the power fails."""
    temporary = path.with_name(f"{path.name}.new")
    try:
        with temporary.open("wb") as file:
            file.write(content)
        sync(temporary)
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def remove_tree(path: Path) -> None:
    """Remove a file, a link, or a folder with its content. A link is not followed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def is_safe_name(name: str) -> bool:
    """Return whether a name from a file names a place of a result: inside the folder, and not in its hidden one."""
    if not name or "\0" in name:
        return False
    path = PurePosixPath(name)
    plain = not path.is_absolute() and str(path) == name and ".." not in path.parts
    return plain and path.parts != () and path.parts[0] != HOME


def under(out: Path, name: str) -> Path:
    """Return the place of a result; a link to another folder is refused."""
    path = out / name
    for folder in path.relative_to(out).parents:
        place = out / folder
        if folder.name and (place.is_symlink() or (place.exists() and not place.is_dir())):
            kind = "link" if place.is_symlink() else "file"
            raise OutputError(f"{place} is a {kind} where results belong: remove it, or give another --out")
    return path


#: The hidden folder of the program in an output folder.
HOME = ".slam-init"
#: The name of the marker in it.
MARKER = "files.json"
#: New results that are not complete, earlier ones while they are replaced, and the renames that replace them.
NEW, OLD = "new", "old"
_JOURNAL = "journal.json"
#: A marker of a comparison with 100,000 recordings has 10 MB.
_MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class Marker:
    """What the program wrote to a folder."""

    #: ``run``, ``compare`` or ``synth``.
    command: str
    #: Version of the program.
    version: str
    #: Relative paths with slashes. A file on the list need not exist.
    files: frozenset[str]

    @classmethod
    def make(cls, command: str, files: frozenset[str] = frozenset()) -> Marker:
        """Make a marker of this version."""
        try:
            return cls(command, version("slam-init"), files)
        except PackageNotFoundError:  # run from a checkout
            return cls(command, "unknown", files)


@dataclass(frozen=True)
class _Stored:
    """The content of the marker, and of the journal."""

    command: str
    version: str
    files: tuple[str, ...]
    #: Of a journal: the files that are moved to their places, and those that are removed.
    put: tuple[str, ...] = ()
    remove: tuple[str, ...] = ()
    schema: Literal[1] = 1

    def text(self) -> bytes:
        return json.dumps(asdict(self), indent=1).encode() + b"\n"

    @staticmethod
    def read(out: Path, name: str) -> _Stored | None:
        path = out / HOME / name
        if (out / HOME).is_symlink() or not path.is_file():
            return None
        try:
            if path.stat().st_size > _MAX_BYTES:
                raise ValueError("too large")
            stored = parsed(_Stored, path.read_bytes())
            if not all(is_safe_name(name) for name in (*stored.files, *stored.put, *stored.remove)):
                raise ValueError("a name outside the folder")
        except ValueError:
            raise OutputError(f"{path} is damaged: remove {out}, or give another --out") from None
        return stored

    @property
    def marker(self) -> Marker:
        return Marker(self.command, self.version, frozenset(self.files))


def read_marker(out: Path) -> Marker | None:
    """Read the marker of a folder."""
    stored = _Stored.read(out, MARKER)
    return None if stored is None else stored.marker


def write_marker(out: Path, marker: Marker) -> None:
    """Write the marker of a folder."""
    stored = _Stored(marker.command, marker.version, tuple(sorted(marker.files)))
    replace_synced(out / HOME / MARKER, stored.text())


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
            marker = self.marker
            files = tuple(sorted(marker.files))
            journal = _Stored(marker.command, marker.version, files, self.put, self.remove)
            replace_synced(out / HOME / _JOURNAL, journal.text())
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


def pending(out: Path) -> Renames | None:
    """Return the renames that a killed command has begun."""
    stored = _Stored.read(out, _JOURNAL)
    return None if stored is None else Renames(stored.put, stored.remove, stored.marker)
