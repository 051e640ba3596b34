"""The compiled loops of lenses: the projection of points with its derivatives, and the inverse of the distortion.

The lens models are those of :class:`slam_init.types.camera.Camera`.

A camera is a vector of 31 numbers: the model (0 pinhole, 1 radtan, 2 fisheye, 3 a lens of
:mod:`slam_init.lenses.lens`), fx, fy, cx, cy, five coefficients of the distortion (0 where the model has fewer), the
largest ``|(x, y) / z|`` that the lens sees, and the twenty numbers of the lens: the profile, its three parameters, the
thirteen coefficients of the bending, the two limits of the field, and the factor from a change of ``k1`` to one of
``n1``.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from quest.algebra import Floats
from quest.jit import compiler_of, inlined

#: The folder, for the compilers of loops that call these.
FOLDER = Path(__file__).parent
compiled = compiler_of(FOLDER)
#: For what only other loops call.
part = compiler_of(FOLDER, part=True)

#: Newton's method doubles the number of correct digits in each step, and ends where a step is smaller than this. Real
#: lenses need 4 to 8 steps; pixels near the radius at which the lens polynomial stops growing need more.
_STEPS, _SETTLED = 30, 1e-13
#: Largest error of lens coordinates that are distorted again: 1e-7 px for a focal length of 1000 px.
_SOLVED = 1e-10


# -- a point --------------------------------------------------------------------------------------


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


# -- many points ----------------------------------------------------------------------------------


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


@compiled
def undistorted(distorted: Floats, start: Floats, bending: Floats, limit: float) -> Floats:
    """Lens coordinates that the distortion moves to given places, by Newton's method.

    Shapes: ``distorted`` (N, 2), ``start`` (N, 2), ``bending`` (13,), returns (N, 3).

    * ``start``: Where the iteration begins.
    * ``limit``: Largest radius.
    * Returns: The coordinates, and the length of (u, v, 1); NaN beyond the limit, where another ray has the same pixel,
      and where the distortion moves the coordinates to another place.
    """
    n1, n2, n3, n4, d1, d2, d3 = bending[0], bending[1], bending[2], bending[3], bending[4], bending[5], bending[6]
    p1, p2, s1, s2, s3, s4 = bending[7], bending[8], bending[9], bending[10], bending[11], bending[12]
    found = np.empty((len(distorted), 3))
    is_ratio = d1 != 0.0 or d2 != 0.0 or d3 != 0.0
    for n in range(len(distorted)):
        x, y = start[n, 0], start[n, 1]
        last, left_x, left_y = 1.0, 0.0, 0.0
        for _ in range(_STEPS + 1):
            r2 = x * x + y * y
            radial = 1 + r2 * (n1 + r2 * (n2 + r2 * (n3 + r2 * n4)))
            slope = n1 + r2 * (2 * n2 + r2 * (3 * n3 + r2 * 4 * n4))
            if is_ratio:
                inverse = 1 / (1 + r2 * (d1 + r2 * (d2 + r2 * d3)))
                radial *= inverse
                slope = (slope - radial * (d1 + r2 * (2 * d2 + r2 * 3 * d3))) * inverse
            left_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2) - distorted[n, 0]
            left_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4) - distorted[n, 1]
            if last < _SETTLED:
                break
            prism_x, prism_y = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
            jxx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
            jyy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
            across = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
            jxy, jyx = across + prism_x * y, across + prism_y * x
            inverse = 1 / (jxx * jyy - jxy * jyx)
            step_x, step_y = (jyy * left_x - jxy * left_y) * inverse, (jxx * left_y - jyx * left_x) * inverse
            x, y, last = x - step_x, y - step_y, max(abs(step_x), abs(step_y))
        r2 = x * x + y * y
        # NaN fails each comparison.
        solved = abs(left_x) < _SOLVED and abs(left_y) < _SOLVED and r2 <= limit * limit
        found[n, 0], found[n, 1], found[n, 2] = (x, y, np.sqrt(r2 + 1)) if solved else (np.nan, np.nan, np.nan)
    return found
