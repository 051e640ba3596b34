"""The pixels of many points, and how they follow the points and the lens."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quest.algebra import Floats
from slam_init.lenses.compiler import compiled
from slam_init.lenses.point import project_point


class Projection(NamedTuple):
    """The pixels of points; all rows of a point that the lens does not see are NaN."""

    #: (N, 2)
    pixels: Floats
    #: (N, 2, 3) Their derivatives by the points in the camera frame.
    by_point: Floats
    #: (N, 2) Their derivatives by what is added to the first coefficient of the radial distortion.
    by_k1: Floats


def projected(camera: Floats, points: Floats) -> Projection:
    """Project points, and differentiate their pixels.

    Shapes: ``camera`` (31,), ``points`` (N, 3).
    """
    numbers = np.full((len(points), 10), np.nan)
    _project(camera, np.ascontiguousarray(points), numbers)
    return Projection(numbers[:, :2], numbers[:, 2:8].reshape(-1, 2, 3), numbers[:, 8:])


def moved(camera: Floats, points: Floats, moves: Floats) -> Floats:
    """How pixels move where their points move; 0 for a point that the lens does not see.

    Shapes: ``camera`` (31,), ``points, moves`` (N, 3), returns (N, 2).
    """
    pixels = np.zeros((len(points), 2))
    _move(camera, np.ascontiguousarray(points), np.ascontiguousarray(moves), pixels)
    return pixels


@compiled
def _project(camera: Floats, points: Floats, out: Floats) -> None:
    for n in range(len(points)):
        seen, px, py, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(
            camera, 1.0, 0.0, points[n, 0], points[n, 1], points[n, 2]
        )
        if seen:
            out[n, 0], out[n, 1], out[n, 8], out[n, 9] = px, py, f0, f1
            out[n, 2], out[n, 3], out[n, 4], out[n, 5], out[n, 6], out[n, 7] = a0, a1, a2, b0, b1, b2


@compiled
def _move(camera: Floats, points: Floats, moves: Floats, out: Floats) -> None:
    for n in range(len(points)):
        x, y, z = moves[n, 0], moves[n, 1], moves[n, 2]
        _, _, _, a0, a1, a2, b0, b1, b2, _, _ = project_point(
            camera, 1.0, 0.0, points[n, 0], points[n, 1], points[n, 2]
        )
        out[n, 0], out[n, 1] = a0 * x + a1 * y + a2 * z, b0 * x + b1 * y + b2 * z
