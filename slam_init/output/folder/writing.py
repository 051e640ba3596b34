"""Writes the results of one command to its folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from slam_init.errors import OutputError, check_type
from slam_init.output.folder.marker import (
    HOME,
    MARKER,
    NEW,
    OLD,
    Marker,
    Renames,
    output_error,
    pending,
    remove_tree,
    write_marker,
)
from slam_init.output.folder.ownership import check_folder, refuse_foreign_files
from slam_init.system.process_io import InterruptsDeferred
from slam_init.system.regular_file import user_path

#: Another process may remove the file between opening and locking it. Then the lock is tried again.
_TRIES = 20


class FolderLock:
    """An advisory lock (``flock``) on a file. The system releases it when the process ends, whatever ends it.

    File systems without locks do not refuse a second process.

    * ``path``: The file; it is created if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle: int | None = None

    def acquire(self, out: Path) -> None:
        """Take the lock, or refuse at once."""
        for _ in range(_TRIES):
            handle = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
            if not _lock(handle):
                holder = os.read(handle, 20).decode(errors="replace").strip()
                os.close(handle)
                by = f" (process {holder})" if holder.isdecimal() else ""
                raise OutputError(
                    f"--out {out} is in use by another slam-init{by}: wait for its end, or give another --out"
                )
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), self._path.stat()):
                    self._handle = handle
                    with suppress(OSError):  # a full disk: the number is for the message only
                        os.ftruncate(handle, 0)
                        os.write(handle, f"{os.getpid()}\n".encode())
                    return
            os.close(handle)
        raise OutputError(f"--out {out} is in use by another slam-init: wait for its end, or give another --out")

    def release(self) -> None:
        """Release the lock. It may be called twice."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def _lock(handle: int) -> bool:
    """Lock an open file; return whether no other process holds it."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


_LOCK = "lock"


class OutputFolder:
    """A folder of results while a command writes to it: a context manager.

    On entry the folder is created, checked and locked, renames of a command that was killed are completed, and its
    unfinished files are removed. On exit unfinished files are removed; a folder that was new and received no file is
    removed as well.

    * ``path``: The folder.
    * ``command``: ``run``, ``compare`` or ``synth``.
    * ``targets``: Files that the command may write, as relative paths with slashes. An existing file of such a name
      that is not on the list of the marker is refused on entry.
    * ``staging``: Empty folder on the same file system, for new results.
    """

    def __init__(self, path: str | os.PathLike[str], command: str, targets: Collection[str] = ()) -> None:
        check_type(path, (str, os.PathLike), "the folder", "text, or a pathlib.Path", OutputError)
        # A path of the command line has its home folder already. "./~" has become "~" there.
        self.path = user_path(path) if isinstance(path, str) else Path(path)
        if "\0" in str(self.path):
            raise OutputError(f"the folder {str(self.path)!r:.60} has a null byte: give another one")
        self.staging = self.path / HOME / NEW
        self._command = command
        self._targets = targets
        self._marker = Marker.make(command)
        self._lock = FolderLock(self.path / HOME / _LOCK)
        self._created: list[Path] = []

    @property
    def files(self) -> frozenset[str]:
        """Return the files that the program wrote to the folder so far."""
        return self._marker.files

    def __enter__(self) -> OutputFolder:
        self._marker = check_folder(self.path, self._command, self._targets)
        locked = False
        try:
            self._create()
            self._lock.acquire(self.path)
            locked = True
            step = pending(self.path)
            if step is not None:
                step.complete(self.path)
            # Before it got the lock, another command may have written to the folder.
            self._marker = check_folder(self.path, self._command, self._targets)
            self._clear()
            self.staging.mkdir()
            write_marker(self.path, self._marker)
        except BaseException as error:
            # Without the lock, the hidden folder belongs to the process that holds it.
            self._leave(remove=locked)
            if isinstance(error, OSError):
                raise output_error(self.path, error) from error
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._leave(remove=True)

    def claim(self, names: Iterable[str]) -> None:
        """Put files on the list that the command writes to their places itself. Call it before they are written."""
        names = frozenset(names)
        refuse_foreign_files(self.path, self._marker, names)
        for name in names:
            path = self.path / name
            if path.is_symlink() or (path.exists() and not path.is_file()):  # a pipe would block
                raise OutputError(f"{path} is not a file that slam-init wrote: move it, or give another --out")
        marker = replace(Marker.make(self._command), files=self._marker.files | names)
        try:
            write_marker(self.path, marker)
        except OSError as error:
            raise output_error(self.path, error) from error
        self._marker = marker

    def publish(self, names: Sequence[str], remove: Collection[str] = ()) -> None:
        """Move files from :attr:`staging` to their places: all of them, or none.

        * ``names``: Relative paths with slashes. The last one is put last, so it says that the others are there.
        * ``remove``: Files of :attr:`files` that are removed; names that are published are ignored.
        """
        refuse_foreign_files(self.path, self._marker, names)
        removed = sorted((set(remove) & self.files) - set(names))
        marker = Marker.make(self._command, (self.files - set(removed)) | set(names))
        # Half of the renames must not stay because of a key that was pressed.
        with InterruptsDeferred():
            Renames(tuple(names), tuple(removed), marker).perform(self.path)
            self._marker = marker

    def _create(self) -> None:
        """Create the folder with its parents, and remember which ones were new."""
        missing = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
        for folder in reversed(missing):
            folder.mkdir(exist_ok=True)
            self._created.append(folder)
        (self.path / HOME).mkdir(exist_ok=True)

    def _clear(self) -> None:
        """Remove what a command that was killed has left."""
        for entry in (self.path / HOME).iterdir():
            if entry.name not in (MARKER, _LOCK):
                remove_tree(entry)

    def _leave(self, *, remove: bool) -> None:
        """Remove unfinished files, and folders that received no file; release the lock."""
        home = self.path / HOME
        with suppress(OSError, OutputError):
            if remove:
                self._clear_home(home)
            else:
                home.rmdir()  # it was created just now, or is not empty
        self._lock.release()
        for folder in reversed(self._created):
            with suppress(OSError):  # it holds files
                folder.rmdir()

    def _clear_home(self, home: Path) -> None:
        """Remove unfinished files, unless the next command has to complete their renames."""
        if pending(self.path) is None:
            for name in (NEW, OLD):
                remove_tree(home / name)
            if not self._marker.files:
                remove_tree(home)


def staged_names(folder: OutputFolder) -> list[str]:
    """Return the files in the staging folder."""
    try:
        found = [path for path in folder.staging.rglob("*") if not path.is_dir()]
    except OSError as error:
        raise output_error(folder.path, error) from error
    return sorted(path.relative_to(folder.staging).as_posix() for path in found)
