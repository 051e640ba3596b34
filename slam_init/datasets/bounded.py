"""Reads JSON and numpy files of strangers: bounded in size, and checked before anything large is allocated."""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from typing import Any, cast

from numpy.typing import NDArray

from slam_init.errors import SourceError
from slam_init.system.numpy_file import parse_npz
from slam_init.system.regular_file import check_inside, open_regular, read_regular

#: The top level of a JSON file. A value is checked when it is read.
JsonObject = dict[str, object]

# A million poses with file names have 100 to 400 MB as JSON; the largest scenes in use have a few thousand.
_MAX_JSON_BYTES = 100_000_000


def read_json(path: str | os.PathLike[str], root: str | os.PathLike[str], what: str) -> JsonObject:
    """Read a JSON file with an object at its top.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    check_inside(path, root)
    data = read_regular(path, _MAX_JSON_BYTES, what, SourceError)
    try:
        content = json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise SourceError(f"{path}:{error.lineno}: broken JSON: {error.msg}") from None
    except (UnicodeDecodeError, ValueError, RecursionError):  # ValueError: an integer of thousands of digits
        raise SourceError(f"{path}: not a JSON file of {what}") from None
    if not isinstance(content, dict):
        raise SourceError(f"{path}: not {what}: expected a JSON object")
    return cast(JsonObject, content)


def first_bytes(path: str | os.PathLike[str], count: int) -> bytes:
    """Read the start of a file, by which its kind is told."""
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
