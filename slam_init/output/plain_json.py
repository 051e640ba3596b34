"""Converts dataclasses to plain JSON types: for files and the recording."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from enum import Enum
from typing import Any, TypeAlias

import numpy as np

#: The types that :mod:`json` writes and reads.
Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"

#: Significant digits of floats, unless a field has its own number.
DIGITS = 6


def plain(value: Any, digits: int = DIGITS) -> Json:
    """Convert a value to plain JSON types.

    * ``value``: Dataclasses become objects, sequences and arrays become lists, enumerations become their value, and
      floats that are not finite become None.
    * ``digits``: Significant digits of floats. A field of a dataclass may have its own number in its metadata, as
      ``digits``.
    """
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    if dataclasses.is_dataclass(value):
        return plain_fields(value, digits)
    if isinstance(value, Mapping):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, digits) for item in value]
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def json_text(value: Any, digits: int = DIGITS) -> str:
    """Write a value as indented JSON with a final newline. The text is ASCII, which any stream can encode."""
    return json.dumps(plain(value, digits), indent=2, allow_nan=False) + "\n"


def plain_fields(value: Any, digits: int = DIGITS) -> dict[str, Json]:
    """Convert the fields of a dataclass to plain JSON types, by name."""
    return {
        item.name: plain(getattr(value, item.name), item.metadata.get("digits", digits))
        for item in dataclasses.fields(value)
    }
