"""Array types for annotations, whose shapes are stated in the docstrings; and evenly spaced positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
