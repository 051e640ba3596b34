"""Standard streams and interrupts of a command, which it shares with the process that started it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

from slam_init.errors import OutputError, plain_line

__all__ = ["InterruptsNoted", "NativeStderrSilenced", "complain", "fill_closed_streams", "tell"]


def fill_closed_streams() -> None:
    """Connect standard streams that the caller closed to the null device.

    Otherwise the next file that is opened would become the standard output, and printed text would go into it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor, which is this one
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)


def tell(text: str) -> None:
    """Write to the standard output. If the reader of a pipe has closed it, the text is dropped without an error.

    Parameters
    ----------
    text : str
        With line ends. Characters that the encoding of the stream lacks are escaped.

    Raises
    ------
    OutputError
        If the text cannot be written for another reason.
    """
    try:
        # File names may hold characters that the encoding of the stream lacks.
        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
    except OSError as error:
        _drop_stdout()
        raise OutputError(
            f"cannot write to standard output ({error.strerror}): redirect it to a place with free space"
        ) from None


def _drop_stdout() -> None:
    # Python flushes the rest of the buffer at exit. Without the null device this would fail again, with a message.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)


class InterruptsNoted:
    """A context manager that records an interrupt in ``seen`` and raises it as usual.

    Attributes
    ----------
    seen : bool
        Whether an interrupt has come since the start of the context.
    """

    def __enter__(self) -> InterruptsNoted:
        self.seen = False
        self._before = None
        # Only the main thread may handle signals. If interrupts are ignored (nohup, &), they stay ignored.
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
    """Write a message to the standard error as one line that starts with ``slam-init:``.

    Parameters
    ----------
    message : str
        Line breaks and other characters that are no plain text are escaped.
    """
    print("slam-init:", plain_line(message), file=sys.stderr)


class NativeStderrSilenced:
    """A context manager that drops the output of C libraries on file descriptor 2; ``sys.stderr`` still works.

    The decoders in OpenCV print lines about a broken file that no log level suppresses.
    """

    def __enter__(self) -> None:
        sys.stderr.flush()
        self._original = os.dup(2)
        self._stderr = sys.stderr
        try:
            redirect = sys.stderr.fileno() == 2
        except (OSError, ValueError):  # a stderr that is not a file
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
