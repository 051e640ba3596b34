"""The compiled fit of a view of a camera that rotates: its rotation, its zoom and its shift, by rays of the world."""

from __future__ import annotations

import numpy as np

from quest.algebra import median_in_place, solve_in_place, turn
from slam_init.types.arrays import Floats
from slam_init.window.compiler import compiled
from slam_init.window.projection import project_point
from slam_init.window.vectors import cross, to_view, vector_of

#: Steps of a view, and the change of a rotation (rad) and of a zoom below which they end: a hundredth of a pixel.
_STEPS, _CONVERGED = 20, 1e-5
#: Longest step of a rotation (rad) and of the logarithm of a zoom: outliers must not throw a view away.
_LONGEST_STEP = 0.2
#: The weights of the residuals are those of Geman and McClure, at twice the scale of the median residual.
_OF_MEDIAN, _OF_SCALE = 1.4826, 2.0


@compiled
def locate_view(
    camera: Floats,
    world: Floats,
    pixels: Floats,
    R: Floats,
    zoom: float,
    shift: Floats,
    shift_px: float,
    sigma_px: Floats,
) -> tuple[Floats, float, Floats, float]:
    """The rotation, the zoom and the shift of a view by rays of the world and their pixels.

    Robust least squares: up to half of the tracks may be outliers.

    Shapes: ``camera`` (31,), ``world`` (N, 3), ``pixels`` (N, 2), ``R`` (3, 3), ``shift`` (2,), ``sigma_px`` (N,),
    returns ``R`` (3, 3) and ``shift`` (2,).

    * ``shift_px``: Standard deviation of the shift. It has a prior, since a small rotation moves the pixels alike.
    * Returns ``median``: Of the lengths of the residuals.
    """
    R, shift, log_zoom, median = R.copy(), shift.copy(), np.log1p(zoom), np.inf
    left, J, lengths = np.empty((len(world), 2)), np.empty((len(world), 2, 5)), np.empty(len(world))
    normal, step = np.empty((6, 6)), np.empty(6)
    for _ in range(_STEPS):
        factor, visible, turned = np.exp(log_zoom), True, R.reshape(1, 3, 3)
        for i in range(len(world)):
            z, inverse = to_view(turned, 0, vector_of(world, i)), 1.0 / sigma_px[i]
            seen, x, y, a0, a1, a2, b0, b1, b2, _, _ = project_point(camera, 1.0, 0.0, z[0], z[1], z[2])
            visible &= seen
            projected = (factor * (x - camera[3]), factor * (y - camera[4]))
            by_turn = (cross(z, (a0, a1, a2)), cross(z, (b0, b1, b2)))
            # The derivatives of the projection by the rotation vector, the logarithm of the zoom, and its own shift.
            for q in range(2):
                left[i, q] = (pixels[i, q] - camera[3 + q] - shift[q] - projected[q]) * inverse
                for p in range(3):
                    J[i, q, p] = factor * by_turn[q][p] * inverse
                J[i, q, 3], J[i, q, 4] = projected[q] * inverse, inverse
            lengths[i] = np.sqrt(left[i, 0] ** 2 + left[i, 1] ** 2)
        if not visible:
            break
        median = median_in_place(lengths.copy())
        scale = _OF_SCALE * max(1.0, _OF_MEDIAN * median)
        normal[:], step[:] = 1e-9 * np.eye(6), 0.0
        for q in range(2):
            normal[4 + q, 4 + q] += 1.0 / shift_px**2
            step[4 + q] = -shift[q] / shift_px**2
        for i in range(len(world)):
            far = 1.0 + (lengths[i] / scale) ** 2
            weight = 1.0 / (far * far)
            for q in range(2):
                of_shift = weight * J[i, q, 4]
                step[4 + q] += of_shift * left[i, q]
                normal[4 + q, 4 + q] += of_shift * J[i, q, 4]
                for p in range(4):
                    weighted = weight * J[i, q, p]
                    step[p] += weighted * left[i, q]
                    normal[p, 4 + q] += weighted * J[i, q, 4]
                    for r in range(p, 4):
                        normal[p, r] += weighted * J[i, q, r]
        for p in range(6):
            for r in range(p):
                normal[p, r] = normal[r, p]
        solve_in_place(normal, step)
        largest = max(max(abs(step[0]), abs(step[1])), max(abs(step[2]), abs(step[3])))
        step *= min(1.0, _LONGEST_STEP / max(largest, _CONVERGED))
        turn(R, step[0], step[1], step[2])
        log_zoom += step[3]
        shift += step[4:]
        if largest < _CONVERGED:
            break
    return R, np.expm1(log_zoom), shift, median
