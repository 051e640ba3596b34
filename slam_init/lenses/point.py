"""The compiled projection of a point, with its derivatives.

The lens models are those of :class:`slam_init.types.camera.Camera`.

A camera is a vector of numbers: the model (0 pinhole, 1 radtan, 2 fisheye, 3 a lens of
:mod:`slam_init.lenses.ray`), fx, fy, cx, cy, five coefficients of the distortion (0 where the model has
fewer), the largest ``|(x, y) / z|`` that the lens sees, and the numbers of the lens.
"""

from __future__ import annotations

import numpy as np

from quest.algebra import Floats
from quest.jit import inlined
from slam_init.lenses.compiler import compiled
from slam_init.lenses.ray import project_ray


@inlined
def radial_and_tangential(
    k1: float, k2: float, p1: float, p2: float, k3: float, x: float, y: float, r2: float
) -> tuple[float, float, float, float, float]:
    """A point bent by the radtan model: u, v, then the derivatives uu, uv = vu, vv by x and y."""
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@compiled
def project_point(
    camera: Floats, scale: float, k1: float, X: float, Y: float, Z: float
) -> tuple[bool, float, float, float, float, float, float, float, float, float, float]:
    """Project a point, and differentiate its pixel by the point and by the distortion.

    The results are numbers and not arrays: a call that fills arrays takes four times as long.

    Shapes: ``camera`` (31,).

    * ``scale``: Factor of the focal length. The derivative of the pixel by the logarithm of the scale is the pixel less
      the principal point.
    * Returns ``seen``: Whether the lens sees the point; otherwise the numbers are 0.
    """
    if camera[0] == 3.0:
        return project_ray(camera, scale, k1, X, Y, Z)
    if Z <= 0.0:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    inverse = 1.0 / Z
    x, y = X * inverse, Y * inverse
    r2 = x * x + y * y
    if r2 >= camera[10] * camera[10]:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ratio_by_k1 = r2
    k1 += camera[5]
    k2, k3, k4, k5 = camera[6], camera[7], camera[8], camera[9]
    u, v, uu, uv, vu, vv = x, y, 1.0, 0.0, 0.0, 1.0
    if camera[0] != 2.0:  # k3, k4 are p1, p2; k5 is k3
        u, v, uu, uv, vv = radial_and_tangential(k1, k2, k3, k4, k5, x, y, r2)
        vu = uv
    elif r2 > 1e-16:
        r = np.sqrt(r2)
        angle = np.arctan(r)
        a2 = angle * angle
        distorted = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
        growth = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
        ratio = distorted / r
        bend = (growth / (1.0 + r2) - ratio) / r2
        ratio_by_k1 = a2 * angle / r
        u, v = x * ratio, y * ratio
        uu, uv, vu, vv = ratio + x * x * bend, x * y * bend, x * y * bend, ratio + y * y * bend
    fx, fy = scale * camera[1], scale * camera[2]
    gx, gy = fx * inverse, fy * inverse
    return (
        True, fx * u + camera[3], fy * v + camera[4],
        gx * uu, gx * uv, -gx * (uu * x + uv * y), gy * vu, gy * vv, -gy * (vu * x + vv * y),
        fx * x * ratio_by_k1, fy * y * ratio_by_k1,
    )  # fmt: skip
