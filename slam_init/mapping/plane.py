"""The plane that the matches of a motion lie on."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Floats


def plane_of_motion(R: Floats, t: Floats, m: Floats, n: Floats) -> Floats:
    """Find the plane that explains most matches of a motion, by iteratively reweighted least squares.

    A match of the plane ``k . X = 1`` obeys ``n x (R m + t (k . m)) = 0``.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``m, n`` (N, 3), returns (3,).

    * Returns: The vector k, in the frame of camera 1 and in units of 1 / norm(t).
    """
    n_cross_t = np.cross(n, t)
    gain = np.linalg.norm(n_cross_t, axis=1)
    along = n_cross_t / np.maximum(gain, 1e-300)[:, None]
    offset = -np.einsum("ij,ij->i", along, np.cross(n, m @ R.T))
    A = m * gain[:, None]
    weight = np.ones(len(m))
    k = np.zeros(3)
    for _ in range(6):
        weighted = A * weight[:, None]
        k = np.linalg.lstsq(weighted.T @ A, weighted.T @ offset, rcond=None)[0]
        r = offset - A @ k
        scale = max(1.4826 * float(np.median(np.abs(r))), 1e-12)
        weight = 1 / (1 + (r / (3 * scale)) ** 2) ** 2
    return np.asarray(k)
