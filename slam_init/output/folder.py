"""The folder of a command's results: whose it is, and how new results replace earlier ones.

**Whose it is.** A folder of results holds ``.slam-init/files.json``: the command that wrote it, the version, and the
list of its files. A command writes to a folder that is new, empty, or of the same command and without files of others.
Every other folder is refused in one line, and nothing in it is changed.

**How results are replaced.** A command writes into a new folder beside the target. Once its results are whole, the two
folders change places in one step, and the earlier one is removed. A command that ends before, whatever ends it, leaves
the earlier results as they are; the next one removes the folder that it has left. A folder that cannot change its place
(a mount point, the current folder, one whose parent cannot be written) gets the files one by one, the last one last. On
a file system without an exchange two steps take its place, between which the earlier results stand beside the target.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import json
import os
import shutil
import sys
import uuid
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import slam_init
from slam_init.errors import OutputError
from slam_init.output.names import RUN_FILES
from slam_init.system.process_io import interrupts_deferred
from slam_init.system.regular_file import user_path

#: The folder of the marker, and the marker in it.
HOME = ".slam-init"
_MARKER = "files.json"
#: A folder that holds these only counts as empty: file systems and file managers create them.
_NO_CONTENT = {HOME, "lost+found", ".DS_Store"}
#: Of the files that commands write: a folder does not look like one.
_SUFFIXES = {".jsonl", ".csv", ".html", ".yaml", *(Path(name).suffix for name in RUN_FILES)}
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: ``RENAME_EXCHANGE`` of Linux and ``RENAME_SWAP`` of macOS, and the folder that paths are relative to.
_EXCHANGE, _AT_FDCWD = 2, -100


@contextmanager
def writing(what: object, otherwise: str = "give another folder") -> Iterator[None]:
    """Tell in one line what cannot be written, and what to do."""
    try:
        yield
    except OSError as error:
        remedy = "make room" if error.errno in _NO_SPACE else "give a place that you can write to"
        raise OutputError(f"cannot write {what}: {error.strerror or error}: {remedy}, or {otherwise}") from error


@dataclass(frozen=True)
class Marker:
    """The command that wrote a folder, and the files that it wrote, as relative paths with slashes."""

    command: str
    files: frozenset[str] = frozenset()

    def write(self, folder: Path) -> None:
        """Write the marker of a folder: completely or not at all."""
        content = {"command": self.command, "version": slam_init.__version__, "files": sorted(self.files)}
        home = folder / HOME
        home.mkdir(exist_ok=True)
        new = home / f"{_MARKER}.new"
        new.write_text(json.dumps(content, indent=1) + "\n")
        new.replace(home / _MARKER)


def read_marker(out: Path) -> Marker | None:
    """Read the marker of a folder; None where there is none."""
    path = out / HOME / _MARKER
    if (out / HOME).is_symlink() or not path.is_file():
        return None
    try:
        content = json.loads(path.read_bytes())
        command, files = content["command"], content["files"]
        if not isinstance(command, str) or not all(isinstance(name, str) for name in files):
            raise TypeError
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is damaged: remove {out}, or give another folder") from None
    return Marker(command, frozenset(files))


def chosen_folder(text: str, command: str, inputs: Iterable[str | os.PathLike[str]] = ()) -> Path:
    """Return the folder of the option ``--out``.

    A place that the command cannot or must not write to is refused before any work. Nothing is created.

    * ``inputs``: Files and folders that the command reads. A name that is no path is ignored.
    """
    out = user_path(text)
    try:
        str(out).encode()
        if not out.exists() and out.suffix.lower() in _SUFFIXES:
            raise OutputError(f"--out {out} names a file: give a folder, as in {out.with_suffix('').name or 'results'}")
        existing = next(parent for parent in (out, *out.resolve().parents) if parent.exists())
    except UnicodeEncodeError:
        raise OutputError(f"--out {str(out)!r}: bytes that are no UTF-8 cannot name a recording: rename it") from None
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: links in a circle
        raise OutputError(f"--out {str(out)!r} cannot be used ({error})") from None
    if not existing.is_dir():
        raise OutputError(f"--out {out}: {existing} is a file, not a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"--out {out}: no permission to write in {existing}")
    check_folder(out, command)
    for given in inputs:
        path = user_path(given)
        with suppress(OSError, ValueError):  # a name that no file can have
            if path.exists() and path.resolve().is_relative_to(out.resolve()):
                raise OutputError(f"--out {out}: results would replace {path}, which is read: give another folder")
    return out


def check_folder(out: Path, command: str) -> None:
    """Refuse a folder that a command must not write to."""
    with writing(out):
        if not os.path.lexists(out):
            return
        if not out.is_dir():
            raise OutputError(f"{out} is a file: give a folder")
        home = out / HOME
        if home.is_symlink() or (home.exists() and not home.is_dir()):
            raise OutputError(f"{home} is not a folder of slam-init: remove it, or give another folder")
        marker = read_marker(out)
        if marker is None:
            found = next((entry.name for entry in os.scandir(out) if entry.name not in _NO_CONTENT), None)
            if found is not None:
                raise OutputError(
                    f"{out} is not empty, and slam-init did not write it (it holds {found!r}): "
                    "give a new or an empty folder"
                )
            return
        if marker.command != command:
            raise OutputError(f"{out} holds results of slam-init {marker.command}: give another folder")
        foreign = next((name for name in names_in(out) if name not in marker.files), None)
        if foreign is not None:
            raise OutputError(f"{out} holds {foreign!r}, which slam-init did not write: move it first")


def names_in(folder: Path) -> list[str]:
    """Return all files of a folder of results, and the links in it: relative, with slashes, without the marker."""
    paths = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    names = (path.relative_to(folder).as_posix() for path in paths)
    return sorted(name for name in names if name.partition("/")[0] not in _NO_CONTENT)


class OutputFolder:
    """A folder of results while a command writes to it: a context manager.

    On entry the folder is checked, and what killed commands have left beside it is removed. On exit the unfinished
    files are removed.

    * ``path``: The folder.
    * ``command``: The command that it belongs to.
    * ``own``: A file that the command writes to its place itself, and that is no staged file. The folder then stays
      where it is.
    * ``staging``: Empty folder on the same file system, for new results.
    """

    def __init__(self, path: str | os.PathLike[str], command: str, *, own: str | None = None) -> None:
        # A path of the command line has its home folder already. "./~" has become "~" there.
        self.path = path if isinstance(path, Path) else user_path(path, OutputError)
        if "\0" in str(self.path):
            raise OutputError(f"the folder {str(self.path)!r:.60} has a null byte: give another one")
        self._command = command
        self._created: list[Path] = []
        self._lock = -1
        self._own = frozenset[str]() if own is None else frozenset([own])

    def __enter__(self) -> OutputFolder:
        check_folder(self.path, self._command)
        with writing(self.path), ExitStack() as undone:
            undone.callback(self.__exit__)
            # Of a link the folder that it leads to is replaced.
            self._place = self.path.resolve()
            self._in_place = bool(self._own) or self._cannot_move()
            home = self._place / HOME if self._in_place else self._place.parent
            self._created = [folder for folder in (home, *home.parents) if not folder.exists()]
            home.mkdir(parents=True, exist_ok=True)
            prefix = f".{self._place.name}.slam-init-"
            _remove_abandoned(home, prefix)
            self.staging = home / f"{prefix}{uuid.uuid4().hex[:12]}"
            self.staging.mkdir()
            self._lock = os.open(self.staging, os.O_RDONLY)
            with suppress(OSError):  # a file system without locks
                fcntl.flock(self._lock, fcntl.LOCK_EX)
            if self._own:
                self._mark(self._own)
            undone.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock >= 0:
            shutil.rmtree(self.staging, ignore_errors=True)
            os.close(self._lock)
            self._lock = -1
        for folder in self._created:
            with suppress(OSError):  # it holds files
                folder.rmdir()

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write files by name to the staging folder."""
        with writing(self.path):
            for name, content in files.items():
                path = self.staging / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)

    def publish(self, last: str = "") -> None:
        """Replace the earlier results by the staged files: all of them, or none.

        * ``last``: Where the files have to be moved one by one, this one says that the others are there.
        """
        check_folder(self.path, self._command)  # another command may have written to it meanwhile
        with writing(self.path):
            names = names_in(self.staging)
            for name in names:
                with (self.staging / name).open("rb") as file:
                    os.fsync(file.fileno())
            # Half of the renames must not stay because of a key that was pressed.
            with interrupts_deferred():
                Marker(self._command, frozenset(names)).write(self.staging)
                if self._in_place:
                    self._move_each(sorted(names, key=lambda name: name == last))
                else:
                    _exchange(self.staging, self._place)

    def keep(self, name: str) -> None:
        """Put one staged file beside the earlier results, or alone where there are none."""
        self._place.mkdir(exist_ok=True)
        self._mark({name})
        (self.staging / name).replace(self._place / name)

    def _mark(self, names: Set[str]) -> frozenset[str]:
        """Add files to the marker of the folder; return those that it had."""
        earlier = read_marker(self._place) or Marker(self._command)
        Marker(self._command, earlier.files | names).write(self._place)
        return earlier.files

    def _cannot_move(self) -> bool:
        """Whether the folder has to stay where it is."""
        if not self._place.exists():
            return False
        if os.path.ismount(self._place) or not os.access(self._place.parent, os.W_OK | os.X_OK):
            return True
        return Path.cwd().is_relative_to(self._place)

    def _move_each(self, names: list[str]) -> None:
        now = self._own | frozenset(names)
        earlier = self._mark(now)
        for name in names:
            (self._place / name).parent.mkdir(parents=True, exist_ok=True)
            (self.staging / name).replace(self._place / name)
        for name in earlier - now:
            (self._place / name).unlink(missing_ok=True)
            for folder in Path(name).parents[:-1]:
                with suppress(OSError):  # it holds other files
                    (self._place / folder).rmdir()
        Marker(self._command, now).write(self._place)


def _exchange(new: Path, place: Path) -> None:
    """Let a folder take the place of another one in one step; the other one, if there is one, is then at ``new``."""
    if not place.exists():
        new.rename(place)
        return
    libc = ctypes.CDLL(None, use_errno=True)
    paths = os.fsencode(new), os.fsencode(place)
    if sys.platform == "darwin":
        failed = libc.renamex_np(*paths, _EXCHANGE)
    else:
        failed = libc.renameat2(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], _EXCHANGE)
    if not failed:
        return
    if ctypes.get_errno() not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(place))
    # Whatever ends the command between the two steps, no later one removes a folder of this name.
    earlier = new.with_name(f"earlier-{new.name.lstrip('.')}")
    place.rename(earlier)
    try:
        new.rename(place)
    except OSError:
        earlier.rename(place)
        raise
    earlier.rename(new)


def _remove_abandoned(home: Path, prefix: str) -> None:
    """Remove the staging folders of commands that were killed: nobody holds their lock."""
    for folder in home.iterdir():
        if not folder.name.startswith(prefix):
            continue
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(handle)
