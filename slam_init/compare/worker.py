"""The program of the process in which trials run: it reads requests and answers each of them.

:mod:`slam_init.compare.isolation` starts the process.
"""

from __future__ import annotations

import os
import resource
import sys
from multiprocessing.connection import Connection
from pathlib import Path

from slam_init.system.process_guard import guarded


def main(arguments: list[str]) -> None:
    """Answer requests on an inherited connection until it is closed.

    * ``arguments``: File descriptor of the connection; limit of memory in MB, 0 for no limit; process id of the parent.
    """
    descriptor, memory_limit_mb, parent = (int(argument) for argument in arguments)
    guarded(parent)  # before libraries are loaded that start threads: a fork does not copy threads
    from slam_init.compare.answers import answer_to, load_libraries
    from slam_init.compare.isolation import READY, Request

    # Requests come from the comparison, and are pickled. Answers are lines of JSON.
    connection: Connection[bytes, Request] = Connection(descriptor)
    load_libraries()
    if memory_limit_mb:
        _limit_memory(memory_limit_mb)
    _send(descriptor, READY)
    while True:
        try:
            request = connection.recv()
        except EOFError:
            return
        _send(descriptor, answer_to(request).line())


def _send(descriptor: int, line: bytes) -> None:
    while line:
        line = line[os.write(descriptor, line) :]


def _limit_memory(limit_mb: int) -> None:
    """Let allocations beyond the limit fail.

    The address space that is in use now is added to the limit: libraries reserve address space that they never use.
    """
    statm = Path("/proc/self/statm")
    in_use = int(statm.read_text().split()[0]) * resource.getpagesize() if sys.platform == "linux" else 0
    limit = in_use + limit_mb * 2**20
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


if __name__ == "__main__":
    main(sys.argv[1:])
