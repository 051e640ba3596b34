"""The decorator of all compiled loops: the only module of the package that imports numba."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled", "compiler_of"]

Function = TypeVar("Function", bound=Callable[..., object])


def compiler_of(folder: Path) -> Callable[[Function], Function]:
    """The decorator for the compiled loops of a folder.

    numba compiles a function again when the file of this function has changed, and not when the file of a function that
    it calls has changed. So a hash of all sources of the folder, and of this folder, is a part of the name under which
    numba keeps the machine code: an edit of any of these files renews the machine code of all loops.

    Parameters
    ----------
    folder : Path
        Folder of the loops.

    Returns
    -------
    callable
        Compiles a function of numbers and arrays, in the part of Python that numba compiles, at its first call, and
        keeps the machine code on disk. Where no folder can be written (neither that of the package nor that of the
        user), each process compiles for itself.
    """
    files = {*Path(__file__).parent.glob("*.py"), *folder.glob("*.py")}
    sources = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files))).hexdigest()[:8]

    def _compiled(function: Function) -> Function:
        function.__qualname__ = f"{function.__qualname__}_{sources}"
        try:
            return cast("Function", njit(cache=True, error_model="numpy")(function))
        except RuntimeError:
            return cast("Function", njit(error_model="numpy")(function))

    return _compiled


#: The decorator of the loops of this folder.
compiled = compiler_of(Path(__file__).parent)
