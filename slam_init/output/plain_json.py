"""Converts dataclasses to plain JSON types, and back: for files, the recording, and the answers of processes."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, NoReturn, TypeAlias, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

#: The types that :mod:`json` writes and reads.
Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"

#: Significant digits of floats, unless a field has its own number.
DIGITS = 6

_Kind = TypeVar("_Kind")


def plain(value: object, digits: int = DIGITS) -> Json:
    """Convert a value to plain JSON types.

    * ``value``: Dataclasses become objects, sequences and arrays become lists, enumerations become their value, and
      floats that are not finite become None.
    * ``digits``: Significant digits of floats. A field of a dataclass may have its own number in its metadata, as
      ``digits``.
    """
    if isinstance(value, Enum):
        return plain(value.value, digits)
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain_fields(value, digits)
    if isinstance(value, Mapping):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item, digits) for item in value]
    return str(value)


def plain_fields(value: object, digits: int = DIGITS) -> dict[str, Json]:
    """Convert the fields of a dataclass to plain JSON types, by name."""
    if not dataclasses.is_dataclass(value):
        raise TypeError(f"{type(value).__name__} is not a dataclass")
    return {
        item.name: plain(getattr(value, item.name), item.metadata.get("digits", digits))
        for item in dataclasses.fields(value)
    }


def parsed(kind: type[_Kind], text: str | bytes) -> _Kind:
    """Read a dataclass from JSON that may come from anywhere: a value of another type is a ValueError.

    Keys that the dataclass has not are ignored. A field with a default may be absent. All numbers are finite.
    """
    try:
        content = json.loads(text, parse_constant=_finite, parse_float=_finite, parse_int=_small)
    except RecursionError:
        raise ValueError("too deep") from None
    read: Callable[[Any], _Kind] = _reader(cast("Any", kind))
    return read(content)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is not finite")
    return number


def _small(text: str) -> int:
    number = int(text)
    if abs(number) >= 1 << 63:
        raise ValueError("a number has more than 64 bits")
    return number


@cache
def _reader(kind: Any) -> Callable[[Any], Any]:
    """Make the function that reads a value of a type."""
    origin, parts = get_origin(kind), get_args(kind)
    if dataclasses.is_dataclass(kind):
        return _object_reader(kind)
    if kind in (str, bool, int, float):
        # type() and not isinstance(): a bool is no number. A whole number is a float.
        allowed = (int, float) if kind is float else (kind,)
        return lambda value: value if type(value) in allowed else _refuse(value, kind)
    if origin is UnionType:  # T | None, or float | str | None
        readers = [_reader(part) for part in parts if part is not NoneType]
        return lambda value: None if value is None else _first_that_reads(readers, value)
    if origin is Literal:
        return lambda value: value if value in parts else _refuse(value, kind)
    if isinstance(kind, type) and issubclass(kind, tuple):  # a NamedTuple of floats, where null is NaN
        names, figure = get_type_hints(kind), _reader(float)
        return lambda value: kind(
            **{
                name: math.nan if each is None else figure(each)
                for name, each in zip(names, _list(value, kind, len(names)), strict=True)
            }
        )
    if origin is tuple:  # tuple[T, ...]
        item = _reader(parts[0])
        return lambda value: tuple(item(each) for each in _list(value, kind))
    if origin is Mapping:  # Mapping[str, T]
        item = _reader(parts[1])
        return lambda value: {key: item(each) for key, each in _object(value, kind).items()}
    raise TypeError(f"{kind} is not read from JSON")


def _first_that_reads(readers: Sequence[Callable[[Any], Any]], value: Any) -> Any:
    *others, last = readers
    for reader in others:
        with suppress(ValueError):
            return reader(value)
    return last(value)


def _object_reader(kind: Any) -> Callable[[Any], Any]:
    hints = get_type_hints(kind)
    readers = {field.name: _reader(hints[field.name]) for field in dataclasses.fields(kind)}

    def read(value: Any) -> Any:
        content = _object(value, kind)
        try:
            return kind(**{name: reader(content[name]) for name, reader in readers.items() if name in content})
        except TypeError as error:  # a field is missing
            raise ValueError(str(error)) from None

    return read


def _list(value: Any, kind: Any, size: int | None = None) -> list[Any]:
    if not isinstance(value, list) or size not in (None, len(value)):
        _refuse(value, kind)
    return value


def _object(value: Any, kind: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        _refuse(value, kind)
    return value


def _refuse(value: Any, kind: Any) -> NoReturn:
    raise ValueError(f"{value!r:.80} is no {getattr(kind, '__name__', kind)}")
