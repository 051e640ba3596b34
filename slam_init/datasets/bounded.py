"""Reads JSON and numpy files of strangers: bounded in size, and checked before anything large is allocated."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from slam_init.errors import SourceError
from slam_init.system.numpy_file import parse_npz
from slam_init.system.regular_file import check_inside, open_regular, read_regular
from slam_init.types.arrays import Floats

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


def json_number(place: str, content: JsonObject, key: str, default: float | None = None) -> float:
    """Take a finite number out of a JSON object."""
    value = content.get(key, default)
    number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if not math.isfinite(number):
        raise SourceError(f"{place}: {key} is {str(value)[:40]!r}: expected a number")
    return number


def json_array(place: str, value: object, shape: tuple[int, ...], what: str) -> Floats:
    """Convert nested lists of a JSON file to an array of finite numbers."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        expected = "x".join("N" if n < 0 else str(n) for n in shape)
        raise SourceError(f"{place}: {what} is not an array of {expected} finite numbers")
    return array


def read_npz(
    path: str | os.PathLike[str], known: Collection[str], limit_bytes: int, what: str
) -> dict[str, NDArray[np.generic]]:
    """Read named arrays from a ``.npz`` file; see :func:`slam_init.system.numpy_file.parse_npz`."""
    with open_regular(path, SourceError) as file:
        return parse_npz(str(path), file, known, limit_bytes, what)


def checked_array(
    path: Path,
    arrays: Mapping[str, NDArray[np.generic]],
    name: str,
    shape: tuple[int, ...],
    kinds: str,
    what: str,
    *,
    finite: bool = True,
) -> NDArray[Any]:
    """Take an array of a shape and kind.

    * ``shape``: -1 stands for any number.
    * ``kinds``: Kinds of numpy: ``iu`` for whole numbers, ``iuf`` for numbers, ``U`` for text.
    * ``what``: What is expected, for the message.
    * ``finite``: Whether its numbers must be finite.
    """
    if name not in arrays:
        raise SourceError(f"{path}: has no array {name}: expected {what}")
    array = arrays[name]
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in kinds:
        expected = ", ".join("M" if n < 0 else str(n) for n in shape)
        raise SourceError(f"{path}: {name} is {array.dtype} of shape {array.shape}: expected {what} ({expected})")
    if finite and array.dtype.kind == "f" and not np.isfinite(array).all():
        raise SourceError(f"{path}: {name} holds a number that is not finite")
    return array
