"""The compiled projection of rays of any angle, with its derivatives, by a :class:`~slam_init.types.lenses.lens.Lens`.

A lens is a vector of twenty numbers: the profile, its three parameters, the thirteen coefficients of the bending, the
two limits of the field, and the factor from a change of ``k1`` to one of ``n1``.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.lenses.lens import Lens
from slam_init.types.lenses.profiles import Profile
from slam_init.window.compiler import compiled

__all__ = ["LENS_NUMBERS", "lens_vector", "project_ray"]

#: Length of the vector of a lens.
LENS_NUMBERS = 20


def lens_vector(lens: Lens | None) -> Floats:
    """The numbers of a lens for the compiled loops.

    Parameters
    ----------
    lens : Lens or None
        None for the models on the plane z = 1.

    Returns
    -------
    (20,) float
    """
    if lens is None:
        return np.zeros(LENS_NUMBERS)
    bent = 0.0 if lens.profile == Profile.PANORAMA else 1 / lens.magnification**2
    return np.array([lens.profile, *lens.shape, *lens.bending, *lens.field_limits, bent], float)


@compiled
def _profile(lens: Floats, X: float, Y: float, Z: float, out: Floats) -> bool:
    """Whether the lens sees a ray; out (8,) receives u, v and the derivatives of u, then of v, by X, Y, Z."""
    kind, s = lens[0], X * X + Y * Y
    if kind == 3.0:
        level2 = X * X + Z * Z
        level, all2 = np.sqrt(level2), level2 + Y * Y
        out[0], out[1] = np.arctan2(X, Z), np.arctan2(Y, level)
        if level == 0.0 or abs(out[0]) > lens[17] or abs(out[1]) > lens[18]:
            return False
        out[2], out[3], out[4] = Z / level2, 0.0, -X / level2
        out[5], out[6], out[7] = -X * Y / (level * all2), level / all2, -Z * Y / (level * all2)
        return True
    r = np.sqrt(s)
    if np.arctan2(r, Z) > lens[17] or (s == 0.0 and Z <= 0.0):
        return False
    # The coordinates are (X, Y) g; the derivatives of g by s = X^2 + Y^2 and by Z follow.
    if kind == 0.0:
        xi, a, b = lens[1], lens[2], lens[3]
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
            steep, gain = 2.0 * np.tan(0.5 * lens[1]), 1.0 / lens[1]
        if s <= 1e-12 * Z * Z:
            g = gain * steep / Z
            g_s, g_Z = -gain * steep**3 / (3.0 * Z**3), -g / Z
        else:
            angle, all2 = np.arctan2(steep * r, Z), Z * Z + steep * steep * s
            g = gain * angle / r
            g_s = 0.5 * gain * (steep * Z / all2 - angle / r) / s
            g_Z = -gain * steep / all2
    out[0], out[1] = X * g, Y * g
    out[2], out[3], out[4] = g + 2.0 * X * X * g_s, 2.0 * X * Y * g_s, X * g_Z
    out[5], out[6], out[7] = 2.0 * X * Y * g_s, g + 2.0 * Y * Y * g_s, Y * g_Z
    return True


@compiled
def project_ray(
    lens: Floats,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    k1: float,
    X: float,
    Y: float,
    Z: float,
    pixel: Floats,
    by_point: Floats,
    by_k1: Floats,
) -> bool:
    """Project a point in any direction, and differentiate its pixel by the point and by the distortion.

    Parameters
    ----------
    lens : (20,) float
        Of :func:`lens_vector`.
    fx, fy, cx, cy : float
        In pixels.
    k1 : float
        Radial distortion that is added.
    X, Y, Z : float
        The point in the camera frame, in any scale.
    pixel : (2,) float
        Receives the pixel.
    by_point : (2, 3) float
        Receives the derivatives by X, Y and Z.
    by_k1 : (2,) float
        Receives the derivatives by k1.

    Returns
    -------
    bool
        Whether the lens sees the point; otherwise nothing is written.
    """
    place = np.empty(8)
    if not _profile(lens, X, Y, Z, place):
        return False
    u, v = place[0], place[1]
    n1, n2, n3, n4 = lens[4] + k1 * lens[19], lens[5], lens[6], lens[7]
    d1, d2, d3 = lens[8], lens[9], lens[10]
    p1, p2, s1, s2, s3, s4 = lens[11], lens[12], lens[13], lens[14], lens[15], lens[16]
    s = u * u + v * v
    N, D = 1.0 + s * (n1 + s * (n2 + s * (n3 + s * n4))), 1.0 + s * (d1 + s * (d2 + s * d3))
    N_s, D_s = n1 + s * (2.0 * n2 + s * (3.0 * n3 + s * 4.0 * n4)), d1 + s * (2.0 * d2 + s * 3.0 * d3)
    ratio, change = N / D, (N_s * D - N * D_s) / (D * D)
    prism_u, prism_v = 2.0 * (s1 + 2.0 * s2 * s), 2.0 * (s3 + 2.0 * s4 * s)
    across = 2.0 * u * v * change + 2.0 * p1 * u + 2.0 * p2 * v
    uu = ratio + 2.0 * u * u * change + 2.0 * p1 * v + 6.0 * p2 * u + prism_u * u
    uv, vu = across + prism_u * v, across + prism_v * u
    vv = ratio + 2.0 * v * v * change + 6.0 * p1 * v + 2.0 * p2 * u + prism_v * v
    pixel[0] = fx * (u * ratio + 2.0 * p1 * u * v + p2 * (s + 2.0 * u * u) + s * (s1 + s * s2)) + cx
    pixel[1] = fy * (v * ratio + p1 * (s + 2.0 * v * v) + 2.0 * p2 * u * v + s * (s3 + s * s4)) + cy
    by_k1[0] = fx * lens[19] * u * s / D
    by_k1[1] = fy * lens[19] * v * s / D
    for q in range(3):
        by_point[0, q] = fx * (uu * place[2 + q] + uv * place[5 + q])
        by_point[1, q] = fy * (vu * place[2 + q] + vv * place[5 + q])
    return True
