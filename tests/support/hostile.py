"""Methods that break what they can. A comparison has to lose their trials, and nothing else.

Each function is the damage of a method: ``HOSTILE`` in ``hostile:HOSTILE`` is its name in
capitalized words, for example ``LoopsInC`` for :func:`loops_in_c`.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np

from slam_init.errors import OutputError
from slam_init.methods.two_view import PairRule

#: A file that code in a pickle would create.
PICKLE_FILE = "SLAM_INIT_PICKLE_FILE"


class _Method:
    pair_rule = PairRule(min_features=10, min_matches=10, min_landmarks=10)
    damage: Callable[[], object]

    def bootstrap(self, *_: object) -> object:
        """Do the damage, then fail."""
        type(self).damage()
        raise RuntimeError("the damage is done")


def _write_to_all_files(data: bytes) -> None:
    """Write to all open files: the connection to the comparison is one of them."""
    for descriptor in range(3, 50):
        try:
            os.write(descriptor, data)
        except OSError:
            continue


def exits() -> None:
    """Ends the process as a program does."""
    sys.exit(0)


def exits_at_once() -> None:
    """Ends the process without cleaning up."""
    os._exit(0)


def aborts() -> None:
    """Ends the process by SIGABRT."""
    os.abort()


def segfaults() -> None:
    """Reads memory that is not there."""
    ctypes.string_at(0)


def loops_in_python() -> None:
    """Never ends."""
    while True:
        pass


def loops_in_c() -> None:
    """Never ends, and no other thread of the interpreter runs."""
    sum(itertools.repeat(0))


def eats_memory() -> None:
    """Allocates without end."""
    eaten = []
    while True:
        eaten.append(np.ones(2_000_000))


def recurses() -> None:
    """Calls itself without end."""
    recurses()


def breaks_libraries() -> None:
    """Replaces functions of the libraries that other methods use."""
    import cv2

    import slam_init.methods.models as models

    for module in (np.linalg, cv2, models):
        for name in [name for name in dir(module) if callable(getattr(module, name)) and name[0] != "_"]:
            setattr(module, name, None)


def prints() -> None:
    """Writes 20 MB to the standard streams."""
    for descriptor in (1, 2):
        for _ in range(10):
            os.write(descriptor, b"noise\n" * 170_000)


def leaves_threads() -> None:
    """Leaves threads that do not end with the program."""
    for _ in range(5):
        threading.Thread(target=time.sleep, args=(1000,)).start()


def leaves_processes() -> None:
    """Leaves processes that it has started."""
    for _ in range(3):
        subprocess.Popen(["sleep", "1000"])


def takes_signals() -> None:
    """Ignores all signals, then hangs."""
    for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
        signal.signal(number, signal.SIG_IGN)
    time.sleep(1000)


def closes_files() -> None:
    """Closes all files of the process."""
    os.closerange(0, 1000)
    time.sleep(1000)


def writes_to_all_files() -> None:
    """Writes noise to all open files."""
    _write_to_all_files(b"\xff\x00noise\n" * 100)


def sends_half_an_answer() -> None:
    """Sends the begin of an answer, and hangs."""
    _write_to_all_files(b'{"request": "TrialRequest", ')
    time.sleep(1000)


class _Command:
    """Creates a file where it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return os.system, (f"touch '{os.environ[PICKLE_FILE]}'",)


def sends_a_pickle() -> None:
    """Sends code in a pickle, framed as the messages of :mod:`multiprocessing`."""
    content = pickle.dumps(_Command())
    _write_to_all_files(len(content).to_bytes(4, "big") + content + b"\n")


def forges_another_trial() -> None:
    """Answers with a good row of another method."""
    row = b'{"source": "points:room?views=5&seed=1", "method": "stella", "start": 0, "outcome": "correct", '
    row += b'"group": "points:room", "frames_limit": 5}'
    _write_to_all_files(b'{"request": "TrialRequest", "memory_exhausted": false, "row": ' + row + b"}\n")


def sends_numbers_that_are_none() -> None:
    """Answers with numbers that are not finite."""
    _write_to_all_files(b'{"request": "TrialRequest", "memory_exhausted": false, "digest": NaN}\n')


def sends_without_end() -> None:
    """Answers with a line that has no end."""
    while True:
        _write_to_all_files(b"x" * 65536)


def raises_without_text() -> None:
    """Raises an error whose text raises another one."""

    class NamelessError(Exception):
        def __str__(self) -> str:
            raise ValueError("no text")

    raise NamelessError


def raises_an_interrupt() -> None:
    """Raises what a key press raises."""
    raise KeyboardInterrupt


def blames_the_disk() -> None:
    """Raises the error of a full disk."""
    raise OutputError("the disk is full")


def kills_its_parent() -> None:
    """Kills the process above its own."""
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(1000)


def kills_its_group() -> None:
    """Kills all processes of its group."""
    os.killpg(0, signal.SIGKILL)


def moves_away() -> None:
    """Changes the working directory, the environment and the limits of the process."""
    import resource

    os.chdir("/")
    os.environ.clear()
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))


class Returns(_Method):
    """Returns something that is no outcome."""

    def bootstrap(self, *_: object) -> object:
        """Return a text."""
        return "accepted"


def _make_methods() -> dict[str, type[_Method]]:
    damages = [found for name, found in globals().items() if name[0] != "_" and callable(found)]
    methods = {}
    for damage in damages:
        if getattr(damage, "__module__", "") == __name__ and not isinstance(damage, type):
            name = "".join(word.capitalize() for word in damage.__name__.split("_"))
            methods[name] = type(name, (_Method,), {"__doc__": damage.__doc__, "damage": staticmethod(damage)})
    return methods


globals().update(_make_methods())
