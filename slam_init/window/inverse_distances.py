"""The compiled start of the inverse distances of a fit, by linear least squares."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.compiler import compiled


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
