"""Reads untrusted files: regular files only, and no more bytes than a bound.

A named pipe without a writer, a terminal or a device would keep a reader for ever, and a file may be larger than the
memory. The type is looked up before the file is opened. It is looked up again in the open file, which is opened
without waiting, because the file may have been replaced in between.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from slam_init.errors import SlamInitError, SourceError, check_type

#: By the first letter that :func:`stat.filemode` gives.
_KINDS = {"d": "a folder", "p": "a named pipe", "s": "a socket", "c": "a device", "b": "a device"}


def user_path(text: str | os.PathLike[str], error: type[SlamInitError] = SourceError) -> Path:
    """Make a path of what a user typed.

    * ``text``: ``~`` and ``~name`` at the start stand for a home folder. If there is no such user, they stand for
      themselves.
    * ``error``: Raised where it is no path.
    """
    check_type(text, (str, os.PathLike), "the path", "text, or a pathlib.Path", error)
    return Path(os.path.expanduser(text))  # noqa: PTH111 (Path.expanduser raises where there is no such user)


def kind_problem(path: str | os.PathLike[str]) -> str | None:
    """Find why a path is no regular file, without opening it. Links are followed.

    * Returns: The rest of a sentence that starts with the path; None for a regular file.
    """
    path = Path(path)
    try:
        return _mode_problem(path.stat().st_mode)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        if isinstance(error, FileNotFoundError) and path.is_symlink():
            return "cannot be read: it is a link to a file that does not exist"
        return f"cannot be read ({getattr(error, 'strerror', error)})"


def _mode_problem(mode: int) -> str | None:
    if stat.S_ISREG(mode):
        return None
    return f"cannot be read: it is {_KINDS.get(stat.filemode(mode)[0], 'something else')}, not a file"


def open_regular(path: str | os.PathLike[str], error: type[SlamInitError]) -> BinaryIO:
    """Open a regular file for reading. Nothing else is opened.

    * ``error``: Raised where this is no regular file, or where it cannot be opened.
    """
    if problem := kind_problem(path):
        raise error(f"{path}: {problem}")
    try:
        # Opening a pipe that has come since must not wait for its writer.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror})") from None
    file = os.fdopen(descriptor, "rb")
    if problem := _mode_problem(os.fstat(descriptor).st_mode):
        file.close()
        raise error(f"{path}: {problem}")
    return file


def first_bytes(path: str | os.PathLike[str], count: int) -> bytes:
    """Read the start of a file of a source, which shows its kind."""
    with open_regular(path, SourceError) as file:
        return file.read(count)


def read_regular(path: str | os.PathLike[str], limit_bytes: int, what: str, error: type[SlamInitError]) -> bytes:
    """Read a regular file of limited size.

    * ``limit_bytes``: Largest size. The size is looked up before anything is read, and no more than this is read.
    * ``error``: Raised where this is no regular file, or where it cannot be read or is larger.
    """
    with open_regular(path, error) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            data = b"" if size > limit_bytes else file.read(limit_bytes + 1)
        except OSError as problem:
            raise error(f"{path}: cannot be read ({problem.strerror})") from None
    if max(size, len(data)) > limit_bytes:
        limit = f"{limit_bytes // 10**6} MB" if limit_bytes >= 10**6 else f"{limit_bytes // 1000} kB"
        raise error(f"{path}: has more than {limit}: this is not {what}")
    return data


def check_inside(path: str | os.PathLike[str], root: str | os.PathLike[str]) -> None:
    """Check that a file that was found in the folder of a source does not lie elsewhere.

    The user names a source, and allows that what is in it is read. A link in it, a path with ``..`` or an absolute path
    in one of its lists may lead to any other file, which the user did not name. A link that stays in the folder is
    followed, and so is a link that the user names as the source.
    """
    try:
        target = os.path.realpath(path, strict=False)
        if Path(target).is_relative_to(os.path.realpath(root)):
            return
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: cannot be read ({error})") from None
    raise SourceError(
        f"{path}: leads out of the folder {root}, to {target}: copy the file into the folder, or name its own folder"
    )
