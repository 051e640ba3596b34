"""One thread for the linear algebra of small matrices."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController

__all__ = ["single_threaded"]


@cache
def _controller() -> ThreadpoolController:
    # It looks for the libraries of the process, which takes some milliseconds: once is enough.
    return ThreadpoolController()


def single_threaded() -> AbstractContextManager[object]:
    """Limit the linear algebra library of numpy to one thread.

    With matrices of some hundred rows, several threads wait for each other longer than they compute: on two busy cores
    the elimination of the tracks took 5.6 ms with two threads, and 0.3 ms with one. One core is also what the
    initializer is meant to need.

    Returns
    -------
    context manager
        The earlier limit returns at its end.
    """
    limited: AbstractContextManager[object] = _controller().limit(limits=1, user_api="blas")
    return limited
