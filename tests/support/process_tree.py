"""Which processes of a command are left. Each command has a mark in its environment, which its children inherit."""

from __future__ import annotations

import os
import time
import uuid
from contextlib import suppress
from pathlib import Path

#: The variable that holds the mark.
MARK = "SLAM_INIT_ATTACK"


def new_mark() -> str:
    """Return a mark that no other process has."""
    return uuid.uuid4().hex


def processes_with(mark: str) -> list[int]:
    """Return the processes whose environment holds a mark, without this one and those that have ended."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            environment = (folder / "environ").read_bytes()
            if f"{MARK}={mark}".encode() in environment and int(folder.name) != os.getpid():
                found.append(int(folder.name))
    return found


def left_over(mark: str, within_s: float = 3.0) -> list[int]:
    """Return the processes that are left after a time in which they may end."""
    end = time.monotonic() + within_s
    while (found := processes_with(mark)) and time.monotonic() < end:
        time.sleep(0.02)
    return found
