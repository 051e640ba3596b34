"""The Rerun viewer that shows a recording while it is made: one that is started, or one that runs somewhere."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

from slam_init.errors import OutputError
from slam_init.system.ports import answers, answers_within
from slam_init.system.process_guard import RELEASE, launcher

#: Given instead of an address, it means that a viewer is started on this machine.
SPAWN = "spawn"

_SCHEMES = ("rerun+http", "rerun+https", "rerun")
#: Port of Rerun's viewer.
VIEWER_PORT = 9876
# A viewer that was started here answers within this time, or its window does not open.
_START_S = 20.0

#: The viewer that this process has started.
_viewer: subprocess.Popen[bytes] | None = None


def viewer_url(text: str) -> str:
    """Find a viewer, or start one. A viewer that already runs on this machine is used.

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


def _spawned() -> str:
    if not answers("127.0.0.1", VIEWER_PORT):
        beside = Path(sys.executable).with_name("rerun")  # where pip puts it, also if the environment is not active
        executable = shutil.which("rerun") or (str(beside) if beside.is_file() else None)
        if executable is None:
            raise OutputError("--live: the Rerun viewer is not installed: pip install rerun-sdk")
        global _viewer
        # As rerun.spawn starts it, under a guard: a run that is killed leaves no viewer with its port.
        words = [executable, f"--port={VIEWER_PORT}", "--memory-limit=75%", "--expect-data-soon"]
        silent = subprocess.DEVNULL
        _viewer = subprocess.Popen(
            [*launcher(), *words], stdin=silent, stdout=silent, stderr=silent, start_new_session=True
        )
        if not answers_within("127.0.0.1", VIEWER_PORT, _viewer, _START_S):
            raise OutputError(
                "--live: the viewer does not start here, for example without a display: give the address of one that "
                "runs elsewhere (--live=rerun+http://HOST:9876/proxy), or leave --live out"
            )
    return f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"


def leave_open() -> None:
    """Let a viewer that this process has started outlive it: a window that the user looks at."""
    if _viewer is not None and _viewer.poll() is None:
        _viewer.send_signal(RELEASE)
