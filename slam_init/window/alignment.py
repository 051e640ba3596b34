"""The compiled alignment of the views of a window by rotations."""

from __future__ import annotations

import numpy as np

from quest.algebra import median_in_place
from quest.robust.kernels.refinement import refine_rotation
from slam_init.types.arrays import Floats
from slam_init.window.compiler import compiled, part

#: Scales of the robust kernel that aligns two views by a rotation. The first one reaches 25 degrees, the angle between
#: two photos of a panorama; the last one is a few pixels. At each scale so many steps are taken.
_SCALES_RAD, _STEPS = (0.4, 0.1, 0.03, 0.01), 4


@compiled
def align_with_first(bearings: Floats, R: Floats) -> None:
    """Align the first view with each view by a rotation, from no rotation and from a proposed one.

    Shapes: ``bearings`` (V, T, 3), ``R`` (V, 3, 3).

    * ``bearings``: NaN where a view does not see a track.
    * ``R``: The second one is the proposal for its view. Receives the rotations: the proposal for a further view is
      that of the second one, and a view with fewer than three common tracks has none.
    """
    V, T = bearings.shape[:2]
    m, n, left, tried = np.empty((T, 3)), np.empty((T, 3)), np.empty(T), np.empty((3, 3))
    none, proposal = np.eye(3), R[1].copy()
    _copy(none, R[0])
    for k in range(1, V):
        count = 0
        for i in range(T):
            if np.isfinite(bearings[0, i, 0]) and np.isfinite(bearings[k, i, 0]):
                for q in range(3):
                    m[count, q], n[count, q] = bearings[0, i, q], bearings[k, i, q]
                count += 1
        _copy(none, R[k])
        least = np.inf
        for start in range(2 if count >= 3 else 0):
            _copy(proposal if start == 1 else none, tried)
            for scale_rad in _SCALES_RAD:
                refine_rotation(m[:count], n[:count], tried, scale_rad, int(_STEPS))  # not the constant: compiled once
            for i in range(count):
                square = 0.0
                for q in range(3):
                    turned = tried[q, 0] * m[i, 0] + tried[q, 1] * m[i, 1] + tried[q, 2] * m[i, 2]
                    square += (n[i, q] - turned) ** 2
                left[i] = np.sqrt(square)
            median = median_in_place(left[:count])
            if median < least:
                least = median
                _copy(tried, R[k])
        if k == 1:
            _copy(R[1], proposal)


@part
def _copy(R: Floats, to: Floats) -> None:
    for p in range(3):
        for q in range(3):
            to[p, q] = R[p, q]
