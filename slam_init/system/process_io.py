"""Standard streams and interrupts of a command, which it shares with the process that started it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType
from typing import TypeAlias

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


def tell(text: str) -> bool:
    """Write to the standard output. If the reader of a pipe has closed it, the text is dropped without an error.

    * ``text``: With line ends. Characters that the encoding of the stream lacks are escaped.
    * Returns: Whether somebody may read it.
    """
    try:
        # File names may hold characters that the encoding of the stream lacks.
        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
        return False
    except OSError as error:
        _drop_stdout()
        raise OutputError(
            f"cannot write to standard output ({error.strerror}): redirect it to a place with free space"
        ) from None
    return True


def _drop_stdout() -> None:
    # Python flushes the rest of the buffer at exit. Without the null device this would fail again, with a message.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)


#: A callback has ended after this time, in seconds; else the interrupt comes once more.
_AGAIN_S = 0.1


class InterruptsNoted:
    """A context manager in which SIGTERM and SIGHUP interrupt the program as SIGINT does, by a KeyboardInterrupt.

    Python drops what is raised in a callback of a C library, as those of the compiler. Such an interrupt comes again.

    * ``seen``: The first signal that has come since the start of the context; None if none has come.
    """

    def __enter__(self) -> InterruptsNoted:
        self.seen: int | None = None
        self._before = _replace_handlers(self._note, (signal.default_int_handler, signal.SIG_DFL))
        self._hook_before, sys.unraisablehook = sys.unraisablehook, self._dropped
        return self

    def _dropped(self, what: sys.UnraisableHookArgs) -> None:
        if self.seen is not None and isinstance(what.exc_value, KeyboardInterrupt):
            # Not from here: what a handler raises now would be dropped too.
            threading.Timer(_AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, self.seen)).start()
        else:
            self._hook_before(what)

    def _note(self, number: int, _: FrameType | None) -> None:
        self.seen = self.seen or number
        raise KeyboardInterrupt

    def __exit__(self, *_: object) -> None:
        sys.unraisablehook = self._hook_before
        _restore_handlers(self._before)


class InterruptsDeferred:
    """A context manager for a short step that must not be interrupted: signals are raised at its end."""

    def __enter__(self) -> None:
        self._seen: list[int] = []
        self._before = _replace_handlers(lambda number, _: self._seen.append(number))

    def __exit__(self, *_: object) -> None:
        _restore_handlers(self._before)
        for number in self._seen:
            signal.raise_signal(number)


class FirstInterruptCalls:
    """A context manager in which the first interrupt calls a function; further ones interrupt as before.

    * ``at_first``: Takes nothing. It runs in a signal handler, so that it must not wait for a lock.
    """

    def __init__(self, at_first: Callable[[], object]) -> None:
        self._at_first = at_first

    def __enter__(self) -> FirstInterruptCalls:
        self._before = _replace_handlers(self._tell)
        return self

    def _tell(self, _: int, __: FrameType | None) -> None:
        _restore_handlers(self._before)
        self._at_first()

    def __exit__(self, *_: object) -> None:
        _restore_handlers(self._before)


#: Handlers by the number of the signal.
_Handlers: TypeAlias = "dict[int, Callable[[int, FrameType | None], object] | int | None]"


def _replace_handlers(
    handler: Callable[[int, FrameType | None], object], replaced: Sequence[object] | None = None
) -> _Handlers:
    """Set a handler of the signals that end a program; return the earlier ones.

    Signals that are ignored (nohup, &) stay ignored. With ``replaced``, only these handlers are replaced: a program
    with handlers of its own keeps them.
    """
    before: _Handlers = {}
    # Only the main thread may handle signals.
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            number = getattr(signal, name, None)
            earlier = None if number is None else signal.getsignal(number)
            if number is None or earlier in (None, signal.SIG_IGN) or (replaced and earlier not in replaced):
                continue
            before[number] = earlier
            signal.signal(number, handler)
    return before


def _restore_handlers(before: _Handlers) -> None:
    for number, handler in before.items():
        signal.signal(number, handler)


def complain(message: str) -> None:
    """Write a message to the standard error as one line that starts with ``slam-init:``.

    * ``message``: Line breaks and other characters that are no plain text are escaped.
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
