"""Reads untrusted files: bounded in size, and checked before anything large is allocated."""

from __future__ import annotations

import os
from collections.abc import Collection
from typing import Any

from numpy.typing import NDArray

from slam_init.errors import SourceError
from slam_init.system.numpy_file import parse_npz
from slam_init.system.regular_file import open_regular


def first_bytes(path: str | os.PathLike[str], count: int) -> bytes:
    """Read the start of a file, which shows its kind."""
    with open_regular(path, SourceError) as file:
        return file.read(count)


def read_npz(
    path: str | os.PathLike[str], required: Collection[str], limit_bytes: int, what: str, optional: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """Read named arrays from a ``.npz`` file; see :func:`slam_init.system.numpy_file.parse_npz`.

    * ``required, optional``: Names of the arrays.
    """
    with open_regular(path, SourceError) as file:
        arrays = parse_npz(str(path), file, (*required, *optional), limit_bytes, what)
    if missing := [name for name in required if name not in arrays]:
        raise SourceError(f"{path}: has no array {missing[0]}: expected {what}")
    return arrays
