"""The error for a wrong input, and the checks of arguments.

Every function that the package exports raises :class:`InputError`, and nothing else, for a wrong input: a wrong shape,
something that is no number, NaN or infinity, a ray of length zero, a threshold that is no angle. Data that allow no
answer are no error: the answer is then a value (see :class:`quest.NoPose`). The inner modules take arrays that were
checked here.
"""

from __future__ import annotations

from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class InputError(ValueError):
    """The input is wrong; the message says in one line what is wrong and what to give instead."""


def as_floats(values: ArrayLike, name: str) -> Floats:
    """The values as an array of float64; the argument itself is not changed.

    * ``values``: Booleans, integers, floats of any precision, or objects that are real numbers. Masked arrays without
      masked entries are arrays.
    * Returns: In rows. Not checked for NaN and infinity. A number too large for a double becomes infinity.
    """
    # The loops are compiled for each layout of an array, which takes seconds.
    if type(values) is np.ndarray and values.dtype == np.float64:
        return np.asarray(values, order="C")
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise InputError(f"{name} has masked entries: remove those rows")
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":
            raise TypeError
        if array.dtype == object and not all(isinstance(number, Real) for number in array.flat):
            raise TypeError
        with np.errstate(over="ignore"):  # of a long double
            return array.astype(np.float64, order="C", copy=False)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is no array of real numbers: give floats in a regular shape") from None


def as_pixels(points1: ArrayLike, points2: ArrayLike) -> tuple[Floats, Floats]:
    """Check matched pixels (N, 2)."""
    both = as_floats(points1, "points1"), as_floats(points2, "points2")
    for points, name in zip(both, ("points1", "points2"), strict=True):
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"{name} have shape {points.shape}: give an array (N, 2) of pixels")
        if not np.isfinite(points).all():
            raise InputError(f"{name} hold a number that is not finite: remove those matches")
    if len(both[0]) != len(both[1]):
        raise InputError(f"points1 and points2 have shapes {both[0].shape} and {both[1].shape}: give one shape (N, 2)")
    return both


def as_positive(value: object, name: str, meaning: str, *, or_zero: bool = False) -> float:
    """Check that a value is a positive finite number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    # A bool is an integer in Python; as an argument it is a mistake.
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
        if 0 < number < np.inf or (or_zero and number == 0):
            return number
    raise InputError(f"{name} is {value!r:.60}: give {meaning}")


def as_index(value: object, name: str, at_least: int) -> int:
    """Check that a value is a whole number."""
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= at_least:
        return int(value)
    raise InputError(f"{name} is {value!r:.60}: give a whole number of at least {at_least}")
