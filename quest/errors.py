"""What is wrong with an input, and how arrays come in.

Every function that the package exports raises :class:`InputError`, and nothing else, for an input that it cannot mean:
a wrong shape, no numbers, NaN or infinity, a ray of length zero, a threshold that is no angle. That the data allow no
answer is no error: it is a value (see :class:`quest.NoPose`). The modules beneath take arrays that were checked here.
"""

from __future__ import annotations

from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["InputError", "as_floats", "as_index", "as_positive"]

Floats = NDArray[np.float64]


class InputError(ValueError):
    """The input is wrong; the message says in one line what is wrong and what to give instead."""


def as_floats(values: ArrayLike, name: str) -> Floats:
    """An array of float64 of what the caller gave, which is left as it is.

    Parameters
    ----------
    values : array_like
        Booleans, integers, floats of any precision, or objects that are real numbers. Masked arrays without masked
        entries are arrays.
    name : str
        What the array is called in messages.

    Raises
    ------
    InputError
        Where it is no array of real numbers: ragged, text, complex, dates, masked. Whether the numbers are finite is
        left to the caller; one too large for a double becomes infinity.
    """
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise InputError(f"{name} has masked entries: remove those rows")
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":
            raise TypeError
        if array.dtype == object and not all(isinstance(number, Real) for number in array.flat):
            raise TypeError
        with np.errstate(over="ignore"):  # of a long double
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is no array of real numbers: give floats in a regular shape") from None


def as_positive(value: object, name: str, meaning: str, *, or_zero: bool = False) -> float:
    """A positive finite number (or zero) as a float; InputError with its name and meaning where it is none."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    # A bool is an integer to Python and a mistake here.
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
        if 0 < number < np.inf or (or_zero and number == 0):
            return number
    raise InputError(f"{name} is {value!r:.60}: give {meaning}")


def as_index(value: object, name: str, at_least: int) -> int:
    """A whole number of at least ``at_least``; InputError with its name where it is none."""
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= at_least:
        return int(value)
    raise InputError(f"{name} is {value!r:.60}: give a whole number of at least {at_least}")
