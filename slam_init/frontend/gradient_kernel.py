"""The compiled loop of :func:`slam_init.frontend.flow.gradient_products`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.jit import compiler_of, inlined
from slam_init.types.arrays import Image, Ints

compiled = compiler_of(Path(__file__).parent)


@inlined
def mirrored(index: int, last: int) -> int:
    """An index of a row that goes on mirrored at both ends, without these twice."""
    while index < 0 or index > last:
        index = -index if index < 0 else 2 * last - index
    return index


@compiled
def sums_of_products(image: Image, centres: Ints, radius: int, step: int) -> Ints:
    """Sums over patches of the products of the gradients, at each ``step``-th pixel of each row and column.

    Shapes: ``image`` (H, W), ``centres`` (N, 2), returns (N, 3).

    * ``centres``: Row and column, in steps.
    * ``radius``: Of a patch, in steps.
    * Returns: Of dx dx, dx dy and dy dy, with gradients that are eight times the slope (Sobel's).
    """
    height, width = image.shape
    last_row, last_column = (height - 1) // step, (width - 1) // step
    sums = np.zeros((len(centres), 3), np.int64)
    for n in range(len(centres)):
        xx, xy, yy = np.int64(0), np.int64(0), np.int64(0)
        for j in range(-radius, radius + 1):
            row = step * mirrored(centres[n, 0] + j, last_row)
            above, below = mirrored(row - 1, height - 1), mirrored(row + 1, height - 1)
            for i in range(-radius, radius + 1):
                column = step * mirrored(centres[n, 1] + i, last_column)
                left, right = mirrored(column - 1, width - 1), mirrored(column + 1, width - 1)
                falling = np.int64(image[below, right]) - np.int64(image[above, left])
                rising = np.int64(image[above, right]) - np.int64(image[below, left])
                dx = falling + rising + 2 * (np.int64(image[row, right]) - np.int64(image[row, left]))
                dy = falling - rising + 2 * (np.int64(image[below, column]) - np.int64(image[above, column]))
                xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
        sums[n, 0], sums[n, 1], sums[n, 2] = xx, xy, yy
    return sums
