"""The compiled projection of rays of any angle, with its derivatives, by a model of :mod:`slam_init.lenses.lens`.

A lens is a vector of twenty numbers: the profile, its three parameters, the thirteen coefficients of the bending, the
two limits of the field, and the factor from a change of ``k1`` to one of ``n1``.
"""

from __future__ import annotations

import numpy as np

from quest.algebra import Floats
from slam_init.lenses.compiler import part


@part
def _profile(
    camera: Floats, X: float, Y: float, Z: float
) -> tuple[bool, float, float, float, float, float, float, float, float]:
    """Whether the lens sees a ray; then u, v and the derivatives of u, then of v, by X, Y, Z."""
    kind, s = camera[11], X * X + Y * Y
    if kind == 3.0:
        level2 = X * X + Z * Z
        level, all2 = np.sqrt(level2), level2 + Y * Y
        u, v = np.arctan2(X, Z), np.arctan2(Y, level)
        if level == 0.0 or abs(u) > camera[28] or abs(v) > camera[29]:
            return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        return (
            True, u, v, Z / level2, 0.0, -X / level2, -X * Y / (level * all2), level / all2, -Z * Y / (level * all2),
        )  # fmt: skip
    r = np.sqrt(s)
    if np.arctan2(r, Z) > camera[28] or (s == 0.0 and Z <= 0.0):
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # The coordinates are (X, Y) g; the derivatives of g by s = X^2 + Y^2 and by Z follow.
    if kind == 0.0:
        xi, a, b = camera[12], camera[13], camera[14]
        length = np.sqrt(s + Z * Z)
        z = xi * length + Z
        d = np.sqrt(b * s + z * z)
        g = 1.0 / (a * d + (1.0 - a) * z)
        z_s, z_Z = 0.5 * xi / length, xi * Z / length + 1.0
        g_s = -g * g * (a * (0.5 * b + z * z_s) / d + (1.0 - a) * z_s)
        g_Z = -g * g * (a * z * z_Z / d + (1.0 - a) * z_Z)
    else:
        steep, gain = 1.0, 1.0
        if kind == 2.0:
            steep, gain = 2.0 * np.tan(0.5 * camera[12]), 1.0 / camera[12]
        if s <= 1e-12 * Z * Z:
            g = gain * steep / Z
            g_s, g_Z = -gain * steep**3 / (3.0 * Z**3), -g / Z
        else:
            angle, all2 = np.arctan2(steep * r, Z), Z * Z + steep * steep * s
            g = gain * angle / r
            g_s = 0.5 * gain * (steep * Z / all2 - angle / r) / s
            g_Z = -gain * steep / all2
    return (
        True, X * g, Y * g, g + 2.0 * X * X * g_s, 2.0 * X * Y * g_s, X * g_Z,
        2.0 * X * Y * g_s, g + 2.0 * Y * Y * g_s, Y * g_Z,
    )  # fmt: skip


@part
def project_ray(
    camera: Floats, scale: float, k1: float, X: float, Y: float, Z: float
) -> tuple[bool, float, float, float, float, float, float, float, float, float, float]:
    """Project a point in any direction, and differentiate its pixel by the point and by the distortion.

    Shapes: ``camera`` (31,).

    * ``camera``: Of :attr:`slam_init.types.camera.Camera.numbers`; the last twenty are those of the lens.
    """
    seen, u, v, u0, u1, u2, v0, v1, v2 = _profile(camera, X, Y, Z)
    if not seen:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fx, fy = scale * camera[1], scale * camera[2]
    n1, n2, n3, n4 = camera[15] + k1 * camera[30], camera[16], camera[17], camera[18]
    d1, d2, d3 = camera[19], camera[20], camera[21]
    p1, p2, s1, s2, s3, s4 = camera[22], camera[23], camera[24], camera[25], camera[26], camera[27]
    s = u * u + v * v
    N, D = 1.0 + s * (n1 + s * (n2 + s * (n3 + s * n4))), 1.0 + s * (d1 + s * (d2 + s * d3))
    N_s, D_s = n1 + s * (2.0 * n2 + s * (3.0 * n3 + s * 4.0 * n4)), d1 + s * (2.0 * d2 + s * 3.0 * d3)
    ratio, change = N / D, (N_s * D - N * D_s) / (D * D)
    prism_u, prism_v = 2.0 * (s1 + 2.0 * s2 * s), 2.0 * (s3 + 2.0 * s4 * s)
    across = 2.0 * u * v * change + 2.0 * p1 * u + 2.0 * p2 * v
    uu = ratio + 2.0 * u * u * change + 2.0 * p1 * v + 6.0 * p2 * u + prism_u * u
    uv, vu = across + prism_u * v, across + prism_v * u
    vv = ratio + 2.0 * v * v * change + 6.0 * p1 * v + 2.0 * p2 * u + prism_v * v
    x = u * ratio + 2.0 * p1 * u * v + p2 * (s + 2.0 * u * u) + s * (s1 + s * s2)
    y = v * ratio + p1 * (s + 2.0 * v * v) + 2.0 * p2 * u * v + s * (s3 + s * s4)
    by_k1 = camera[30] * s / D
    return (
        True, fx * x + camera[3], fy * y + camera[4],
        fx * (uu * u0 + uv * v0), fx * (uu * u1 + uv * v1), fx * (uu * u2 + uv * v2),
        fy * (vu * u0 + vv * v0), fy * (vu * u1 + vv * v1), fy * (vu * u2 + vv * v2),
        fx * by_k1 * u, fy * by_k1 * v,
    )  # fmt: skip
