"""Files that survive a power loss, and names that stay inside their folder."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path, PurePosixPath

from slam_init.errors import OutputError

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


def is_safe_name(name: object, hidden: str) -> bool:
    """Return whether a name from a file names a place inside the folder of the results.

    * ``hidden``: Name of the folder that belongs to the program. No result lies in it.
    """
    if not isinstance(name, str) or not name or "\0" in name:
        return False
    path = PurePosixPath(name)
    plain = not path.is_absolute() and str(path) == name and ".." not in path.parts
    return plain and path.parts != () and path.parts[0] != hidden


def under(out: Path, name: str) -> Path:
    """Return the place of a result; a link to another folder is refused."""
    path = out / name
    for folder in path.relative_to(out).parents:
        place = out / folder
        if folder.name and (place.is_symlink() or (place.exists() and not place.is_dir())):
            kind = "link" if place.is_symlink() else "file"
            raise OutputError(f"{place} is a {kind} where results belong: remove it, or give another --out")
    return path
