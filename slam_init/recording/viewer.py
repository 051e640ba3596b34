"""Starts Rerun's viewer on a recording: in a window, for a browser, or without a display for screenshots.

The viewer is the program of the package ``rerun-sdk``. It runs in a process group of its own, which ends with the
command. It listens on this machine only.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from slam_init.errors import SourceError, ViewerError, plain_line
from slam_init.recording.live_viewer import answers
from slam_init.system.regular_file import open_regular

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

_HOST = "127.0.0.1"
#: Rerun's own port of web pages, where it is free. The system chooses all other ports: a viewer sends its recording to
#: another one that has begun to use its port, and a screenshot would show that of somebody else.
_WEB_PORT = 9090
#: A viewer on a software renderer takes 3 s to start on a machine with idle cores.
_START_S, _PAINT_S, _POLL_S = 60.0, 20.0, 0.25
#: A viewer that has closed its connection ends within this time, if it does.
_END_S = 2.0
#: A viewer that loads nothing for this long has found nothing in the file.
_EMPTY_S = 8.0
#: The first bytes of a recording: ``RRF`` and the generation of the format.
_MAGIC = b"RRF"
_WINDOW = "1280x720"


def check_recording(path: Path) -> None:
    """Check that a file is a recording."""
    with open_regular(path, SourceError) as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise SourceError(f"{path}: is not a rerun recording, or is cut off: run again")


def has_display() -> bool:
    """Return whether a window can be opened here.

    * Returns: On Linux whether a display is named in the environment; elsewhere True.
    """
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or not sys.platform.startswith("linux")


def show(path: Path) -> None:
    """Open a recording in a window, and return when the window is closed."""
    with _viewer(_free_port(), str(path)) as running:
        running.wait("viewer", ": try --web or --screenshot")


@dataclass(frozen=True)
class Served:
    """A recording that is served to browsers."""

    #: The address for a browser on this machine.
    url: str
    #: Waits until the server ends.
    wait: Callable[[], None]


@contextmanager
def serve(path: Path, port: int | None = None) -> Iterator[Served]:
    """Serve a recording and the viewer as a web page, on this machine only.

    * Returns: Once the page answers. The server ends with the ``with`` block.
    """
    web, data = port or _free_port(_WEB_PORT), _free_port()
    with _viewer(data, str(path), "--serve-web", "--web-viewer-port", str(web)) as running:
        running.wait_for(web)
        yield Served(
            f"http://{_HOST}:{web}/?url=rerun%2Bhttp%3A%2F%2F{_HOST}%3A{data}%2Fproxy",
            lambda: running.wait("web viewer"),
        )


def screenshots(path: Path, frames: Sequence[int], window: str = _WINDOW) -> dict[int, bytes]:
    """Draw a recording without a display."""
    port = _free_port()
    with _viewer(port, "--headless", "--hide-welcome-screen", "--window-size", window) as running:
        running.wait_for(port)
        try:
            return _screenshots_at(_client(port), path, frames)
        except (AttributeError, ImportError):
            raise ViewerError("the installed viewer takes no screenshots: pip install -U 'rerun-sdk>=0.41'") from None
        except (RuntimeError, OSError) as error:  # OSError: the viewer ended, or was ended, in between
            with suppress(subprocess.TimeoutExpired):
                running.process.wait(_END_S)
                raise running.failure() from None
            raise ViewerError(f"the viewer took no screenshot: {plain_line(str(error))}: try again") from None


def _client(port: int) -> ViewerClient:
    os.environ.setdefault("RERUN_ANALYTICS", "false")
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


class _Running:
    """The program of the viewer, and its messages."""

    def __init__(self, process: subprocess.Popen[bytes], log: BinaryIO) -> None:
        self.process, self._log = process, log

    def wait(self, name: str, advice: str = "") -> None:
        """Wait until it ends."""
        if self.process.wait():
            raise self._ended(name, advice)

    def wait_for(self, port: int) -> None:
        """Wait until a port answers."""
        end = time.monotonic() + _START_S
        while self.process.poll() is None and time.monotonic() < end:
            if answers(_HOST, port):
                return
            time.sleep(_POLL_S)
        if self.process.returncode is not None:
            raise self.failure()
        raise ViewerError(f"the viewer did not start within {_START_S:.0f} s{self._last_line()}")

    def failure(self) -> ViewerError:
        """Why it has ended by itself."""
        text = self._text()
        # With a driver of OpenGL alone the viewer starts and ends without a render context.
        if any(told in text for told in ("raphics adapter", "Vulkan", "render context")):
            return ViewerError(
                "the viewer found no Vulkan driver: install one, on Debian and Ubuntu mesa-vulkan-drivers"
            )
        if "No module named" in text:
            return ViewerError("the viewer is not installed: pip install rerun-sdk")
        return self._ended("viewer")

    def _ended(self, name: str, advice: str = "") -> ViewerError:
        return ViewerError(f"the {name} ended with code {self.process.returncode}{self._last_line()}{advice}")

    def _text(self) -> str:
        """The last messages of the viewer."""
        self._log.seek(max(0, self._log.seek(0, os.SEEK_END) - 10_000))
        return self._log.read().decode(errors="replace")

    def _last_line(self) -> str:
        lines = [line.strip() for line in self._text().split("\n") if line.strip()]
        return f" ({lines[-1][:300]})" if lines else ""


@contextmanager
def _viewer(port: int, *options: str) -> Iterator[_Running]:
    """Run the viewer in a process group of its own, and end it with the ``with`` block."""
    command = [sys.executable, "-m", "rerun", *options, "--port", str(port), "--bind", _HOST]
    environment = {"RERUN_ANALYTICS": "false", "NO_COLOR": "1"} | dict(os.environ)
    null = subprocess.DEVNULL
    with tempfile.TemporaryFile() as log:
        try:
            process = subprocess.Popen(
                command, stdin=null, stdout=log, stderr=log, env=environment, start_new_session=True
            )
        except OSError as error:
            raise ViewerError(f"the viewer cannot be started ({error.strerror}): pip install rerun-sdk") from None
        try:
            yield _Running(process, log)
        finally:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and its children: the module ``rerun`` starts the program, and ends before it."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(OSError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=5)
            break
    end = time.monotonic() + _END_S
    with suppress(OSError):  # none of the group is left
        while time.monotonic() < end:
            os.killpg(process.pid, 0)
            time.sleep(0.01)


def _free_port(preferred: int = 0) -> int:
    for port in dict.fromkeys((preferred, 0)):
        with suppress(OSError), socket.socket() as probe:
            # Without the option a port counts as taken for a minute after its last use.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((_HOST, port))
            return int(probe.getsockname()[1])
    raise ViewerError(f"no free port on {_HOST}")
