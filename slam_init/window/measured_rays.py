"""Compiled parts of the start of a fit: the measured rays, and inverse distances by linear least squares."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.window.compiler import compiled

#: Newton's method ends where it moves a point of the plane z = 1 by less, or after so many steps; a point whose pixel
#: is still off by more has no ray. As :func:`slam_init.types.lenses.lens.RadialTangentialLens.undistort`.
_CONVERGED, _STEPS, _SOLVED = 1e-13, 30, 1e-10


def measured_rays(camera: Camera, pixels: Floats, seen: Bools) -> Floats:
    """The rays of observations, as :meth:`slam_init.types.camera.Camera.bearings` computes them.

    Shapes: ``pixels`` (V, T, 2), ``seen`` (V, T), returns (V, T, 3).

    * Returns: Unit rays in the cameras; NaN for pixels without a ray, any rays where a view does not see a track.
    """
    if camera.lens is not None or camera.model not in ("pinhole", "radtan"):
        return camera.bearings(pixels.reshape(-1, 2)).reshape(*seen.shape, 3)
    numbers = np.zeros(9)
    numbers[:4] = camera.fx, camera.fy, camera.cx, camera.cy
    if camera.is_distorted:
        numbers[4 : 4 + len(camera.distortion)] = camera.distortion
    rays = np.empty((*seen.shape, 3))
    _unproject(numbers, camera.max_tangent, np.ascontiguousarray(pixels), seen, rays)
    return rays


@compiled
def _unproject(camera: Floats, limit: float, pixels: Floats, seen: Bools, rays: Floats) -> None:
    """Rays of pixels; camera (9,) has fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    k1, k2, p1, p2, k3 = camera[4], camera[5], camera[6], camera[7], camera[8]
    bent = k1 != 0.0 or k2 != 0.0 or p1 != 0.0 or p2 != 0.0 or k3 != 0.0
    V, T = seen.shape
    for k in range(V):
        for i in range(T):
            if not seen[k, i]:
                rays[k, i, 0], rays[k, i, 1], rays[k, i, 2] = 0.0, 0.0, 1.0
                continue
            u, v = (pixels[k, i, 0] - camera[2]) / camera[0], (pixels[k, i, 1] - camera[3]) / camera[1]
            x, y = u, v
            du, dv, last = 0.0, 0.0, 1.0
            for _ in range(_STEPS + 1 if bent else 0):
                r2 = x * x + y * y
                radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
                slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
                du = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - u
                dv = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - v
                if last < _CONVERGED:
                    break
                xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
                xy = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
                yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
                inverse = 1.0 / (xx * yy - xy * xy)
                step_x, step_y = (yy * du - xy * dv) * inverse, (xx * dv - xy * du) * inverse
                x, y, last = x - step_x, y - step_y, max(abs(step_x), abs(step_y))
            length = np.sqrt(x * x + y * y + 1.0)
            if not (abs(du) < _SOLVED and abs(dv) < _SOLVED and x * x + y * y < limit * limit):
                length = np.nan
            rays[k, i, 0], rays[k, i, 1], rays[k, i, 2] = x / length, y / length, 1.0 / length


@compiled
def triangulated(R: Floats, t: Floats, bearings: Floats, seen: Bools, anchor: Ints, rays: Floats) -> Floats:
    """Inverse distances along rays, by ``n x (R_k R_a^T (d - rho t_a) + rho t_k) = 0`` for all measured rays n.

    Shapes: ``R`` (V, 3, 3), ``t`` (V, 3), ``bearings`` (V, T, 3), ``seen`` (V, T), ``anchor`` (T,), ``rays`` (T, 3),
    returns (T,).

    * ``anchor``: The view of each ray; tracks with a negative one start in view 0.
    """
    V, T = seen.shape
    inverse = np.zeros(T)
    w, c, f, s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(T):
        a = max(anchor[i], 0)
        for q in range(3):
            w[q] = R[a, 0, q] * rays[i, 0] + R[a, 1, q] * rays[i, 1] + R[a, 2, q] * rays[i, 2]
            c[q] = R[a, 0, q] * t[a, 0] + R[a, 1, q] * t[a, 1] + R[a, 2, q] * t[a, 2]
        numerator, denominator = 0.0, 1e-12
        for k in range(V):
            n0, n1, n2 = bearings[k, i, 0], bearings[k, i, 1], bearings[k, i, 2]
            if not seen[k, i] or k == a or not np.isfinite(n0 + n1 + n2):
                continue
            for p in range(3):
                f[p] = R[k, p, 0] * w[0] + R[k, p, 1] * w[1] + R[k, p, 2] * w[2]
                s[p] = t[k, p] - (R[k, p, 0] * c[0] + R[k, p, 1] * c[1] + R[k, p, 2] * c[2])
            a0, a1, a2 = n1 * f[2] - n2 * f[1], n2 * f[0] - n0 * f[2], n0 * f[1] - n1 * f[0]
            b0, b1, b2 = n1 * s[2] - n2 * s[1], n2 * s[0] - n0 * s[2], n0 * s[1] - n1 * s[0]
            numerator -= a0 * b0 + a1 * b1 + a2 * b2
            denominator += b0 * b0 + b1 * b1 + b2 * b2
        if np.isfinite(numerator / denominator):
            inverse[i] = max(numerator / denominator, 0.0)
    return inverse
