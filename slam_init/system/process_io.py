"""Standard streams and interrupts of a command, which it shares with the process that started it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

from slam_init.errors import OutputError, plain_line


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


def emit(text: str) -> None:
    """Write to the standard output. If the reader of a pipe has closed it, the text is dropped without an error.

    * ``text``: With line ends. Characters that the encoding of the stream lacks are escaped.
    """
    try:
        # File names may hold characters that the encoding of the stream lacks.
        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except OSError as error:
        # Python flushes the rest of the buffer at exit. Without the null device this would fail again, with a message.
        _to_null(1)
        if not isinstance(error, BrokenPipeError):
            raise OutputError(
                f"cannot write to standard output ({error.strerror}): redirect it to a place with free space"
            ) from None


def _to_null(descriptor: int) -> None:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, descriptor)
    os.close(null)


#: The signals that end a program. Windows has no SIGHUP.
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
#: A callback has ended after this time, in seconds; else the interrupt comes once more.
_AGAIN_S = 0.1


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Set a handler of the signals that end a program. Signals that are ignored (nohup, &) stay ignored."""
    in_main = threading.current_thread() is threading.main_thread()  # no other thread may handle signals
    numbers = [n for n in _ENDING if in_main and signal.getsignal(n) not in (None, signal.SIG_IGN)]
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextmanager
def interrupts_noted(seen: list[int]) -> Iterator[None]:
    """Let SIGTERM and SIGHUP interrupt the program as SIGINT does, by a KeyboardInterrupt.

    Python drops what is raised in a callback of a C library, as those of the compiler. Such an interrupt comes again.

    * ``seen``: Gets the signals that come.
    """

    def _note(number: int, _: FrameType | None) -> None:
        seen.append(number)
        raise KeyboardInterrupt

    def _dropped(what: sys.UnraisableHookArgs) -> None:
        if seen and isinstance(what.exc_value, KeyboardInterrupt):
            # Not from here: what a handler raises now would be dropped too.
            threading.Timer(_AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, seen[0])).start()
        else:
            hook_before(what)

    hook_before, sys.unraisablehook = sys.unraisablehook, _dropped
    try:
        with _handled_by(_note):
            yield
    finally:
        sys.unraisablehook = hook_before


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Run a short step that must not be interrupted: signals are raised at its end."""
    seen: list[int] = []
    try:
        with _handled_by(lambda number, _: seen.append(number)):
            yield
    finally:
        for number in seen:
            signal.raise_signal(number)


@contextmanager
def first_interrupt_calls(at_first: Callable[[], object]) -> Iterator[None]:
    """Call a function at the first interrupt; further ones interrupt as before.

    * ``at_first``: Takes nothing. It runs in a signal handler, so that it must not wait for a lock.
    """
    with ExitStack() as handlers:

        def _emit(_: int, __: FrameType | None) -> None:
            handlers.close()
            at_first()

        handlers.enter_context(_handled_by(_emit))
        yield


def complain(message: str) -> None:
    """Write a message to the standard error as one line that starts with ``slam-init:``.

    * ``message``: Line breaks and other characters that are no plain text are escaped.
    """
    print("slam-init:", plain_line(message), file=sys.stderr)


def silence_native_stderr() -> None:
    """Drop from now on what C libraries write to file descriptor 2; ``sys.stderr`` still works.

    The decoders in OpenCV print lines about a broken file that no log level suppresses.
    """
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1, errors="backslashreplace")
    _to_null(2)
