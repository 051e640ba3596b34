"""Machine code on disk: which folders hold it, and how a file is read and written.

A file is named by the function and by a hash of all that its machine code depends on: the sources, the signature, the
processor, and the versions of the compiler and of Python. So nothing is ever out of date, and a file is never changed:

* Processes that run at once write the same file under a name of their own and rename it. There is no index that two of
  them could change at once. A reader sees a whole file or none.
* Processors and versions of a cluster share a folder.
* An edit of any source of a folder gives all its functions new names. Files of former sources stay until the folder is
  deleted.
* Machine code that an installation contains is used by all users, also by those who must not write there.

The file begins with a hash of the rest. A damaged file counts as missing, and it is written again.
"""

from __future__ import annotations

import hashlib
import os
import sys
import uuid
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

_HASH_BYTES = 32


def folders_of(sources: Path) -> tuple[Path, ...]:
    """Where machine code may be, in the order of the search; it is written to the first one that can be written.

    * Returns: The folder that ``NUMBA_CACHE_DIR`` names, and no other, if it is set. Otherwise ``__pycache__`` of the
      sources, then the folder for caches of the user, if the user has a home.
    """
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return (Path(named) / "quest",)
    try:
        return (sources / "__pycache__", _user_folder().expanduser() / "quest")
    except RuntimeError:  # no HOME, and a user whom the system does not know, as in a container
        return (sources / "__pycache__",)


def _user_folder() -> Path:
    """The folder of the user for files that a program can make again."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or "~/AppData/Local")
    if sys.platform == "darwin":
        return Path("~/Library/Caches")
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache")


def name_of(function: str, parts: Iterable[object]) -> str:
    """Name of the file of a function.

    * ``parts``: All that the machine code depends on; the text of each counts.
    """
    digest = hashlib.sha256("\n".join(str(part) for part in parts).encode()).hexdigest()
    return f"{function}-{digest[:32]}.code"


def read(folders: Sequence[Path], name: str) -> bytes | None:
    """Read machine code."""
    for folder in folders:
        try:
            content = (folder / name).read_bytes()
        except OSError:
            continue
        data = content[_HASH_BYTES:]
        if hashlib.sha256(data).digest() == content[:_HASH_BYTES]:
            return data
    return None


def write(folders: Sequence[Path], name: str, data: bytes) -> None:
    """Write machine code to the first folder that can be written; where there is none, nothing happens."""
    for folder in folders:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            _write_whole(folder, name, hashlib.sha256(data).digest() + data)
            return


def _write_whole(folder: Path, name: str, content: bytes) -> None:
    """Write a file under a name that no other process uses, then rename it."""
    own = folder / f".{uuid.uuid4().hex}"
    try:
        own.write_bytes(content)
        own.replace(folder / name)
    except BaseException:
        with suppress(OSError):
            own.unlink()
        raise
