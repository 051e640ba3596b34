"""The Rerun viewer that shows a recording while it is made: one that is started, or one that runs somewhere."""

from __future__ import annotations

import shutil
import socket
import sys
from pathlib import Path
from urllib.parse import urlsplit

from slam_init.errors import OutputError
from slam_init.recording.rerun_recorder import load_rerun

__all__ = ["SPAWN", "VIEWER_PORT", "viewer_url"]

#: Given instead of an address, it means that a viewer is started on this machine.
SPAWN = "spawn"

_SCHEMES = ("rerun+http", "rerun+https", "rerun")
#: Port of Rerun's viewer.
VIEWER_PORT = 9876
# A viewer on the same network answers within this time.
_PATIENCE_S = 3.0


def viewer_url(text: str) -> str:
    """Find a viewer, or start one. A viewer that already runs on this machine is used.

    Parameters
    ----------
    text : str
        ``spawn``, or an address as ``rerun+http://127.0.0.1:9876/proxy``.

    Returns
    -------
    str
        The address.

    Raises
    ------
    OutputError
        If the text is no address, or no viewer answers there.
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
    if not _answers(host, port):
        raise OutputError(f"--live={text}: no viewer answers there: start one (rerun), or leave the address out")
    return text


def _spawned() -> str:
    if not _answers("127.0.0.1", VIEWER_PORT):
        load_rerun()
        import rerun as rr

        beside = Path(sys.executable).with_name("rerun")  # where pip puts it, also if the environment is not active
        executable = shutil.which("rerun") or (str(beside) if beside.is_file() else None)
        try:
            stream = rr.RecordingStream("slam_init")  # without one, Rerun takes itself for disabled
            rr.spawn(port=VIEWER_PORT, connect=False, executable_path=executable, recording=stream)
        except RuntimeError:
            raise OutputError("--live: the Rerun viewer is not installed: pip install rerun-sdk") from None
        if not _answers("127.0.0.1", VIEWER_PORT):
            raise OutputError(
                "--live: the viewer does not start here, for example without a display: give the address of one that "
                "runs elsewhere (--live=rerun+http://HOST:9876/proxy), or leave --live out"
            )
    return f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"


def _answers(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), _PATIENCE_S).close()
    except OSError:
        return False
    return True
