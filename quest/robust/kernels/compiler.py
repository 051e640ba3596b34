"""The decorator of all compiled loops: the only module of the package that imports numba."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled"]

Function = TypeVar("Function", bound=Callable[..., object])

#: Hash of the source of all loops. numba compiles a function again when the file of this function has changed, and not
#: when the file of a function that it calls has changed. So the hash is a part of the name under which numba keeps the
#: machine code: an edit of any file of this folder renews the machine code of all loops.
_SOURCES = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))))


def compiled(function: Function) -> Function:
    """Compile a function at its first call and keep the machine code on disk.

    Parameters
    ----------
    function : callable
        A function of numbers and arrays, in the part of Python that numba compiles.

    Returns
    -------
    callable
        The compiled function. Where no folder can be written (neither that of the package nor that of the user), each
        process compiles for itself.
    """
    function.__qualname__ = f"{function.__qualname__}_{_SOURCES.hexdigest()[:8]}"
    try:
        return cast("Function", njit(cache=True, error_model="numpy")(function))
    except RuntimeError:
        return cast("Function", njit(error_model="numpy")(function))
