"""The Rerun viewer that shows a recording while it is made: one that is started, or one that runs somewhere."""

from __future__ import annotations

import os
import socket
import time
from urllib.parse import urlsplit

from slam_init.errors import OutputError

#: Given instead of an address, it means that a viewer is started on this machine.
SPAWN = "spawn"

_SCHEMES = ("rerun+http", "rerun+https", "rerun")
#: Port of Rerun's viewer.
VIEWER_PORT = 9876
#: A viewer that was started here answers within this time, or its window does not open.
_START_S = 20.0
#: A program on the same network answers within this time.
_PATIENCE_S, _POLL_S = 3.0, 0.1


def viewer_url(text: str) -> str:
    """Find a viewer, or start one, which stays open when the run ends. One that runs on this machine is used.

    * ``text``: ``spawn``, or an address as ``rerun+http://127.0.0.1:9876/proxy``.
    """
    if text == SPAWN:
        return _spawned()
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port or VIEWER_PORT
    except ValueError:
        host, port, parts = None, 0, urlsplit("")
    if parts.scheme not in _SCHEMES or not host:
        raise OutputError(
            f"--live={text}: give the address of a viewer, as in --live=rerun+http://127.0.0.1:9876/proxy"
        )
    if not answers(host, port):
        raise OutputError(f"--live={text}: no viewer answers there: start one (rerun), or leave the address out")
    return text


def answers(host: str, port: int) -> bool:
    """Whether a connection to a port is accepted."""
    try:
        socket.create_connection((host, port), _PATIENCE_S).close()
    except OSError:
        return False
    return True


def _spawned() -> str:
    if not answers("127.0.0.1", VIEWER_PORT):
        os.environ.setdefault("RERUN_ANALYTICS", "false")
        import rerun as rr

        try:
            rr.spawn(port=VIEWER_PORT, connect=False)
        except RuntimeError as error:
            raise OutputError(f"--live: the Rerun viewer does not start: {error}: pip install rerun-sdk") from None
        end = time.monotonic() + _START_S
        while not answers("127.0.0.1", VIEWER_PORT):
            if time.monotonic() > end:
                raise OutputError(
                    "--live: the viewer does not start here, for example without a display: give the address of one "
                    "that runs elsewhere (--live=rerun+http://HOST:9876/proxy), or leave --live out"
                )
            time.sleep(_POLL_S)
    return f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"
