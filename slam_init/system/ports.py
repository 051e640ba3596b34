"""Whether a program listens on a port."""

from __future__ import annotations

import socket
import subprocess
import time

#: A program on the same network answers within this time.
_PATIENCE_S = 3.0
_POLL_S = 0.1


def answers(host: str, port: int) -> bool:
    """Whether a connection to a port is accepted."""
    try:
        socket.create_connection((host, port), _PATIENCE_S).close()
    except OSError:
        return False
    return True


def answers_within(host: str, port: int, process: subprocess.Popen[bytes], seconds: float) -> bool:
    """Wait until a port answers; False if the process that should listen ends, or the time is over."""
    end = time.monotonic() + seconds
    while process.poll() is None and time.monotonic() < end:
        if answers(host, port):
            return True
        time.sleep(_POLL_S)
    return False
