"""Array types for annotations, whose shapes are stated in the docstrings; what callers give, made one of them."""

from __future__ import annotations

import math
from contextlib import suppress
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_init.errors import SlamInitError

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Bools = NDArray[np.bool_]
Image = NDArray[np.uint8]
Pairs = NDArray[np.uint16]


def evenly_spaced(count: int, most: int) -> Ints:
    """Positions in an array, evenly spaced.

    Shapes: returns (N,).
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


#: What is converted to each type of array, by the kinds of numpy, and what it is called.
_TAKEN: dict[type, tuple[str, str]] = {
    np.float64: ("iuf", "finite numbers"),
    np.int64: ("iu", "integers"),
    np.uint8: ("u", "uint8"),
}


def as_array(
    value: object,
    kind: type,
    shape: tuple[int | None, ...],
    what: str,
    give: str = "",
    error: type[SlamInitError] = SlamInitError,
) -> NDArray[Any]:
    """Make an array of what a caller gave, or state in one line why it is none.

    * ``value``: Anything that numpy makes an array of, in any byte order and precision: a list, a matrix, a masked
      array without masked entries. An array that has the type already is returned as it is.
    * ``kind``: ``np.float64``, ``np.int64`` or ``np.uint8``. Images of other types have another range of values: they
      are not converted to uint8.
    * ``shape``: The wanted shape, with None for each length that is free.
    * ``what``: The name of the argument.
    * ``give``: What to give; by default an array of the shape.
    """
    kinds, numbers = _TAKEN[kind]
    lengths = ", ".join("N" if length is None else str(length) for length in shape)
    give = give or f"an array ({lengths}{',' if len(shape) == 1 else ''}) of {numbers}"
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise error(f"{what} has masked entries: leave them out, and give {give}")
    try:
        given = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise error(f"{what} is no regular array: give {give}") from None
    if given.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, given.shape, strict=True)):
        found = f"type {type(value).__name__}" if given.dtype.kind in "OUS" else f"shape {given.shape}"
        raise error(f"{what} has the {found}: give {give}")
    if given.dtype != kind and given.size and (given.dtype.kind not in kinds or kind is np.uint8):
        raise error(f"{what} has the type {given.dtype}: give {give}")
    with np.errstate(over="ignore"):  # of a long double
        array: NDArray[Any] = given.astype(kind, copy=False)
    if kind is np.float64 and not np.isfinite(array).all():
        raise error(f"{what} has a number that is not finite: give {give}")
    if kind is np.int64 and array is not given and (array != given).any():
        raise error(f"{what} has an integer beyond 2^63: give {give}")
    return array


def as_number(value: object, what: str, give: str, error: type[SlamInitError] = SlamInitError) -> float:
    """Make a float of what a caller gave, or state in one line why it is no finite number. A truth value is none."""
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):  # an integer beyond 1.8e308
            if math.isfinite(number := float(value)):
                return number
    raise error(f"{what} is {value!r:.60}: give {give}")


def set_fields(thing: object, **values: object) -> None:
    """Set fields of a frozen dataclass while it is made."""
    for name, value in values.items():
        object.__setattr__(thing, name, value)
