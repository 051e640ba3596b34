"""A lock on an output folder that ends with its process."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

from slam_init.errors import OutputError

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
