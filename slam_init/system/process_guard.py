"""Ends processes when the process that started them ends, whatever ends it.

On Linux the kernel sends a signal to a process whose parent ends (``PR_SET_PDEATHSIG``), also where a method holds the
interpreter in an endless loop. On other systems a process asks for its parent twice a second.

A process in which trials run has a guard: a parent of its own that does nothing but wait. The guard is the leader of
the process group. When the comparison ends, the guard kills the group, and with it the processes that a method has
started.

As a program, this file runs an external program under a guard (:func:`main`). It imports the standard library only, so
that it starts in 20 ms and needs no import path.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import sys
import threading
import time

#: Interval at which a process asks for its parent.
_ASK_S = 0.5
_PR_SET_PDEATHSIG = 1
#: Sent to a guard, it lets the program outlive the parent.
RELEASE = signal.SIGUSR1
#: Exit code if the program cannot be started, as in a shell.
NOT_STARTED = 127


def end_with_parent(parent: int) -> None:
    """Let this process be killed when its parent ends.

    * ``parent``: Process id of the parent. If it has ended already, this process ends at once.
    """
    _signal_at_end_of_parent(signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    if sys.platform != "linux":
        threading.Thread(target=_ask, args=(parent,), daemon=True).start()


def guarded(parent: int) -> None:
    """Fork. The child returns; the parent stays here as its guard, and exits as the child does.

    * ``parent``: Process id of the process that started this one. The caller must be the leader of a process group.
    """
    read, write = os.pipe()
    guard = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(read)  # the other end tells the guard that this process has ended
        end_with_parent(guard)
        return
    os.close(write)
    released, disarmed = threading.Event(), threading.Event()

    def release(*_: object) -> None:
        """The parent leaves the program to the user: a window stays open."""
        released.set()
        _signal_at_end_of_parent(0)
        if os.getppid() == parent:
            disarmed.set()

    def terminate(*_: object) -> None:
        """End the program, unless the parent released it and ended at once: then this signal tells its end."""
        if released.is_set() and not disarmed.is_set():
            disarmed.set()
            return
        _kill_group()

    signal.signal(signal.SIGTERM, terminate)
    signal.signal(RELEASE, release)
    _signal_at_end_of_parent(signal.SIGTERM)
    # The connection and the standard streams are those of the child alone.
    os.closerange(3, read)
    os.closerange(read + 1, 1 << 10)
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            _exit_as(os.waitstatus_to_exitcode(status))
        if os.getppid() != parent and not released.is_set():
            _kill_group()
        readable, _, _ = select.select([read], [], [], _ASK_S)
        if readable:  # the child ends now, or has closed its files
            time.sleep(0.01)


def launcher(memory_limit_mb: int = 0) -> list[str]:
    """The words before those of a program that run it under a guard of this process, in a group of its own."""
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), str(memory_limit_mb)]


def main(arguments: list[str]) -> None:
    """Run an external program in the process group of this process, which becomes its guard.

    * ``arguments``: Process id of the parent; limit of the address space in MB, 0 for no limit; the program and its
      arguments.
    """
    parent, limit_mb, *words = arguments
    guarded(int(parent))
    if int(limit_mb):
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = int(limit_mb) * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Python ignores this signal, and a program would inherit that.
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        os.execvp(words[0], words)
    except OSError as error:
        sys.stderr.write(f"{words[0]}: {error.strerror}\n")
        sys.stderr.flush()
        os._exit(NOT_STARTED)


def _signal_at_end_of_parent(number: int) -> None:
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


def _ask(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_ASK_S)
    os._exit(1)


def _kill_group() -> None:
    os.killpg(0, signal.SIGKILL)


def _exit_as(code: int) -> None:
    """Exit with the code of the child, or by its signal."""
    if code >= 0:
        os._exit(code)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if -code != signal.SIGKILL:
        signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
    os._exit(1)  # the signal is blocked


if __name__ == "__main__":
    main(sys.argv[1:])
