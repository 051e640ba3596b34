"""Rerun's viewer: in a window, for a browser, without a display for screenshots, or beside a run.

The viewer is the command ``rerun`` of the package ``rerun-sdk``. It listens on this machine only. A viewer of a file
runs in a process group of its own, which ends with the command; that of a run stays open.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from urllib.parse import urlsplit

from slam_init.errors import OutputError, SourceError, ViewerError, plain_line
from slam_init.system.regular_file import open_regular

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

#: Given instead of an address, it means that a viewer is started on this machine.
SPAWN = "spawn"
_SCHEMES = ("rerun+http", "rerun+https", "rerun")
_HOST = "127.0.0.1"
#: Rerun's own ports, of its data and of its page for browsers.
VIEWER_PORT, WEB_PORT = 9876, 9090
#: A viewer on a software renderer takes 3 s to start on a machine with idle cores.
_START_S, _PAINT_S, _POLL_S = 60.0, 20.0, 0.25
#: A program on the same network answers within this time.
_ANSWER_S = 3.0
#: A viewer that has closed its connection ends within this time, if it does.
_END_S = 2.0
#: A viewer that loads nothing for this long has found nothing in the file.
_EMPTY_S = 8.0
#: The first bytes of a recording: ``RRF`` and the generation of the format.
_MAGIC = b"RRF"


def check_recording(path: Path) -> None:
    """Check that a file is a recording."""
    with open_regular(path, SourceError) as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise SourceError(f"{path}: is not a rerun recording, or is cut off: run again")


def has_display() -> bool:
    """Return whether a window can be opened here.

    * Returns: On Linux whether a display is named in the environment; elsewhere True.
    """
    return not sys.platform.startswith("linux") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


def show(path: Path) -> None:
    """Open a recording in a window, and return when the window is closed."""
    _run(path, advice="try --web or --screenshot")


def serve(path: Path, port: int) -> None:
    """Serve a recording and the viewer as a web page on this machine; the viewer prints the address."""
    _run(path, "--serve-web", "--web-viewer-port", str(port), advice="try another --port")


def _run(path: Path, *options: str, advice: str) -> None:
    with _viewer(str(path), "--port", "auto", *options) as process:
        if code := process.wait():
            raise ViewerError(f"the viewer ended with code {code}: {advice}")


# -- screenshots -----------------------------------------------------------------------------------


def screenshots(path: Path, frames: Sequence[int], window: str) -> dict[int, bytes]:
    """Draw frames of a recording without a display, -1 for the last one; ``window`` is the size, as 1280x720."""
    with socket.create_server((_HOST, 0)) as free:
        port = int(free.getsockname()[1])
    options = ("--headless", "--hide-welcome-screen", "--window-size", window, "--port", str(port))
    with tempfile.TemporaryFile() as log, _viewer(*options, output=log) as process:
        try:
            if not _answers(_HOST, port, _START_S, process):
                raise ConnectionError(f"it did not start within {_START_S:.0f} s")
            return _screenshots_at(_client(port), path, frames)
        except (AttributeError, ImportError):
            raise ViewerError("the installed viewer takes no screenshots: pip install -U 'rerun-sdk>=0.41'") from None
        except (RuntimeError, OSError) as error:  # OSError: the viewer ended, or was ended, in between
            with suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
                raise _failure(process.returncode, log) from None
            raise ViewerError(f"the viewer took no screenshot: {plain_line(str(error))}: try again") from None


def _client(port: int) -> ViewerClient:
    from rerun.experimental import ViewerClient

    return ViewerClient.connect(f"rerun+http://{_HOST}:{port}/proxy")


def _screenshots_at(client: ViewerClient, path: Path, frames: Sequence[int]) -> dict[int, bytes]:
    client.open(str(path))
    first, last = _range(client, path)
    taken: dict[int, bytes] = {}
    for frame in frames:
        at = last if frame == -1 else frame
        if not first <= at <= last:
            raise ViewerError(f"{path} has no frame {at}: give one from {first} to {last}")
        taken[at] = _settled(client, at)
    return taken


def _range(client: ViewerClient, path: Path) -> tuple[int, int]:
    """First and last frame of the recording, once it is loaded."""
    end = time.monotonic() + _START_S
    idle_since = time.monotonic()
    while time.monotonic() < min(end, idle_since + _EMPTY_S):
        state = client.get_state()
        timelines: list[Any] = [line for one in state.recordings for line in one.timelines if line.name == "frame"]
        if state.loading:
            idle_since = time.monotonic()
        elif timelines and timelines[0].end is not None:
            return int(timelines[0].start), int(timelines[0].end)
        time.sleep(_POLL_S)
    raise ViewerError(f"{path}: the viewer found no frames in it: it is cut off, or the run read none")


def _settled(client: ViewerClient, frame: int) -> bytes:
    """A screenshot of a frame once two in a row are equal: images are decoded, and views laid out, in the background.

    The first layout of a recording moves the cursor to its last frame, also after the cursor was set.
    """
    end = time.monotonic() + _PAINT_S
    before: bytes | None = None
    while True:
        client.set_time("frame", sequence=frame)
        time.sleep(2 * _POLL_S)
        after = client.take_screenshot()
        there = any(one.current_time == frame for one in client.get_state().recordings)
        if there and (after == before or time.monotonic() > end):
            return after
        if time.monotonic() > end:
            raise ViewerError(f"the viewer did not go to frame {frame} within {_PAINT_S:.0f} s: try again")
        before = after if there else None


def _failure(code: int, log: BinaryIO) -> ViewerError:
    """Why the viewer has ended by itself, by its last messages."""
    log.seek(max(0, log.seek(0, os.SEEK_END) - 10_000))
    text = log.read().decode(errors="replace")
    # With a driver of OpenGL alone the viewer starts and ends without a render context.
    if any(words in text for words in ("raphics adapter", "Vulkan", "render context")):
        return ViewerError("the viewer found no Vulkan driver: install one, on Debian and Ubuntu mesa-vulkan-drivers")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return ViewerError(f"the viewer ended with code {code} ({plain_line(lines[-1][:300]) if lines else 'no message'})")


# -- a viewer beside a run -------------------------------------------------------------------------


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
    if not _answers(host, port):
        raise OutputError(f"--live={text}: no viewer answers there: start one (rerun), or leave the address out")
    return text


def _spawned() -> str:
    if not _answers(_HOST, VIEWER_PORT):
        process = _started("--port", str(VIEWER_PORT), "--expect-data-soon", output=subprocess.DEVNULL)
        if not _answers(_HOST, VIEWER_PORT, _START_S, process):
            raise OutputError(
                "--live: the viewer does not start here, for example without a display: give the address of one "
                "that runs elsewhere (--live=rerun+http://HOST:9876/proxy), or leave --live out"
            )
    return f"rerun+http://{_HOST}:{VIEWER_PORT}/proxy"


# -- processes -------------------------------------------------------------------------------------


@contextmanager
def _viewer(*options: str, output: BinaryIO | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run the viewer in a process group of its own, and end the group with the ``with`` block."""
    process = _started(*options, output=output)
    try:
        yield process
    finally:
        # The module ``rerun`` starts the program, and may have ended before it.
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _started(*options: str, output: BinaryIO | int | None) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "rerun", *options, "--bind", _HOST],
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,  # the command line drops what libraries write to stderr
        env={"NO_COLOR": "1"} | dict(os.environ),
        start_new_session=True,
    )


def _answers(host: str, port: int, patience_s: float = 0.0, process: subprocess.Popen[bytes] | None = None) -> bool:
    """Whether a connection to a port is accepted within a time, and before a process ends."""
    end = time.monotonic() + patience_s
    while True:
        with suppress(OSError), socket.create_connection((host, port), _ANSWER_S):
            return True
        if time.monotonic() >= end or (process is not None and process.poll() is not None):
            return False
        time.sleep(_POLL_S)
