"""What a command shares with the process that started it: standard streams and the interrupt."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

from slam_init.errors import OutputError

__all__ = ["InterruptsNoted", "NativeStderrSilenced", "complain", "fill_closed_streams", "tell"]


def fill_closed_streams() -> None:
    """Give standard streams that the caller closed to the null device.

    Otherwise the next file that is opened becomes standard output, and gets what is printed.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)


def tell(text: str) -> None:
    """Write to stdout. A reader that has seen enough and left changes nothing.

    Raises
    ------
    OutputError
        Where it cannot be written for another reason.
    """
    try:
        # Names hold letters that not every stream takes.
        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
    except OSError as error:
        _drop_stdout()
        raise OutputError(
            f"cannot write to standard output ({error.strerror}): redirect it to where there is room"
        ) from None


def _drop_stdout() -> None:
    # What is left in the buffer would fail once more, with a message, when Python flushes it at exit.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)


class InterruptsNoted:
    """While open, an interrupt is remembered as well as raised."""

    def __enter__(self) -> InterruptsNoted:
        self.seen = False
        self._before = None
        # Only the main thread may handle signals; where interrupts are ignored (nohup, &), they stay so.
        if threading.current_thread() is threading.main_thread():
            self._before = signal.getsignal(signal.SIGINT)
        if self._before is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._note)
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        signal.default_int_handler(number, frame)

    def __exit__(self, *_: object) -> None:
        if self._before is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._before)


def complain(message: str) -> None:
    """Write one line to stderr."""
    print("slam-init:", " ".join(message.splitlines()), file=sys.stderr)


class NativeStderrSilenced:
    """While open, what C libraries print on file descriptor 2 goes nowhere; Python's own stderr still works.

    The decoders inside OpenCV describe a broken file in lines of their own, which no log level stops.
    """

    def __enter__(self) -> None:
        sys.stderr.flush()
        self._original = os.dup(2)
        self._stderr = sys.stderr
        try:
            redirect = sys.stderr.fileno() == 2
        except (OSError, ValueError):  # a stderr that is no file
            redirect = False
        if redirect:
            sys.stderr = os.fdopen(os.dup(2), "w", buffering=1, errors="backslashreplace")
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 2)
        os.close(null)

    def __exit__(self, *_: object) -> None:
        os.dup2(self._original, 2)
        os.close(self._original)
        if sys.stderr is not self._stderr:
            sys.stderr.close()
            sys.stderr = self._stderr
