"""Methods that break what they can. A comparison has to lose their trials, and nothing else."""

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
from typing import NoReturn

import numpy as np

from slam_init.errors import OutputError
from slam_init.methods.two_view import PairRule

#: A file that code in a pickle would create.
PICKLE_FILE = "SLAM_INIT_PICKLE_FILE"


class _Method:
    pair_rule = PairRule(min_features=10, min_matches=10, min_landmarks=10)

    def bootstrap(self, *_: object) -> object:
        """Do the damage, then fail."""
        self._damage()
        raise RuntimeError("the damage is done")

    def _damage(self) -> None:
        """What the method breaks."""


class Exits(_Method):
    """Ends the process as a program does."""

    def _damage(self) -> NoReturn:
        sys.exit(0)


class ExitsAtOnce(_Method):
    """Ends the process without cleaning up."""

    def _damage(self) -> NoReturn:
        os._exit(0)


class Aborts(_Method):
    """Ends the process by SIGABRT."""

    def _damage(self) -> NoReturn:
        os.abort()


class Segfaults(_Method):
    """Reads memory that is not there."""

    def _damage(self) -> None:
        ctypes.string_at(0)


class LoopsInPython(_Method):
    """Never ends."""

    def _damage(self) -> NoReturn:
        while True:
            pass


class LoopsInC(_Method):
    """Never ends, and no other thread of the interpreter runs."""

    def _damage(self) -> None:
        sum(itertools.repeat(0))


class EatsMemory(_Method):
    """Allocates without end."""

    def _damage(self) -> NoReturn:
        eaten = []
        while True:
            eaten.append(np.ones(2_000_000))


class Recurses(_Method):
    """Calls itself without end."""

    def _damage(self) -> None:
        self._damage()


class BreaksLibraries(_Method):
    """Replaces functions of the libraries that other methods use."""

    def _damage(self) -> None:
        import cv2

        import slam_init.methods.models as models

        for module in (np.linalg, cv2, models):
            for name in [name for name in dir(module) if callable(getattr(module, name)) and name[0] != "_"]:
                setattr(module, name, None)


class Prints(_Method):
    """Writes 20 MB to the standard streams."""

    def _damage(self) -> None:
        for descriptor in (1, 2):
            for _ in range(10):
                os.write(descriptor, b"noise\n" * 170_000)


class LeavesThreads(_Method):
    """Leaves threads that do not end with the program."""

    def _damage(self) -> None:
        for _ in range(5):
            threading.Thread(target=time.sleep, args=(1000,)).start()


class LeavesProcesses(_Method):
    """Leaves processes that it has started."""

    def _damage(self) -> None:
        for _ in range(3):
            subprocess.Popen(["sleep", "1000"])


class TakesSignals(_Method):
    """Ignores all signals, then hangs."""

    def _damage(self) -> None:
        for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
            signal.signal(number, signal.SIG_IGN)
        time.sleep(1000)


class ClosesFiles(_Method):
    """Closes all files of the process."""

    def _damage(self) -> None:
        os.closerange(0, 1000)
        time.sleep(1000)


class WritesToAllFiles(_Method):
    """Writes noise to all open files: the connection to the comparison is one of them."""

    def _damage(self) -> None:
        for descriptor in range(3, 50):
            try:
                os.write(descriptor, b"\xff\x00noise\n" * 100)
            except OSError:
                continue


class SendsHalfAnAnswer(_Method):
    """Sends the begin of an answer, and hangs."""

    def _damage(self) -> None:
        for descriptor in range(3, 50):
            try:
                os.write(descriptor, b'{"request": "TrialRequest", ')
            except OSError:
                continue
        time.sleep(1000)


class _Command:
    """Creates a file where it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return os.system, (f"touch '{os.environ[PICKLE_FILE]}'",)


class SendsAPickle(_Method):
    """Sends code in a pickle, framed as the messages of :mod:`multiprocessing`."""

    def _damage(self) -> None:
        content = pickle.dumps(_Command())
        for descriptor in range(3, 50):
            try:
                os.write(descriptor, len(content).to_bytes(4, "big") + content + b"\n")
            except OSError:
                continue


class ForgesAnotherTrial(_Method):
    """Answers with a good row of another method."""

    def _damage(self) -> None:
        row = b'{"source": "points:room?views=5&seed=1", "method": "stella", "start": 0, "outcome": "correct", '
        row += b'"group": "points:room", "frames_limit": 5}'
        for descriptor in range(3, 50):
            try:
                os.write(descriptor, b'{"request": "TrialRequest", "memory_exhausted": false, "row": ' + row + b"}\n")
            except OSError:
                continue


class SendsNumbersThatAreNone(_Method):
    """Answers with numbers that are not finite."""

    def _damage(self) -> None:
        for descriptor in range(3, 50):
            try:
                os.write(descriptor, b'{"request": "TrialRequest", "memory_exhausted": false, "digest": NaN}\n')
            except OSError:
                continue


class SendsWithoutEnd(_Method):
    """Answers with a line that has no end."""

    def _damage(self) -> None:
        while True:
            for descriptor in range(3, 50):
                try:
                    os.write(descriptor, b"x" * 65536)
                except OSError:
                    continue


class RaisesWithoutText(_Method):
    """Raises an error whose text raises another one."""

    def _damage(self) -> None:
        class NamelessError(Exception):
            def __str__(self) -> str:
                raise ValueError("no text")

        raise NamelessError


class RaisesAnInterrupt(_Method):
    """Raises what a key press raises."""

    def _damage(self) -> NoReturn:
        raise KeyboardInterrupt


class BlamesTheDisk(_Method):
    """Raises the error of a full disk."""

    def _damage(self) -> NoReturn:
        raise OutputError("the disk is full")


class KillsItsParent(_Method):
    """Kills the process above its own."""

    def _damage(self) -> None:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(1000)


class KillsItsGroup(_Method):
    """Kills all processes of its group."""

    def _damage(self) -> None:
        os.killpg(0, signal.SIGKILL)


class Returns(_Method):
    """Returns something that is no outcome."""

    def bootstrap(self, *_: object) -> object:
        """Return a text."""
        return "accepted"


class MovesAway(_Method):
    """Changes the working directory, the environment and the limits of the process."""

    def _damage(self) -> None:
        import resource

        os.chdir("/")
        os.environ.clear()
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
