"""The plane that the matches of a motion lie on, and whether the points of a window do.

A plane is assumed only where no depth variation shows.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.window.arguments import Limits
from slam_init.window.joint_fit import costs_off_plane
from slam_init.window.kernel import OFF_PLANE_COST
from slam_init.window.levels import (
    LEAST_ON_PLANE,
    LEAST_TRACKS,
    PLANE_SIGMAS,
    VARIATION_SIGMAS,
)
from slam_init.window.motion import FittedMotion, fit_motion
from slam_init.window.state import Priors
from slam_init.window.tracks import WindowTracks


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


def is_plane(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether the points of a fit lie on its plane.

    * Returns: True if distances of their own gain nothing: neither at the poses of the fit, nor where the poses follow.
    """
    return _fits_plane(tracks, fitted) and not _leaves_plane(tracks, fitted, priors)


def _fits_plane(tracks: WindowTracks, fitted: FittedMotion) -> bool:
    """Whether the plane of a fit holds many of its points, and free distances gain nothing."""
    on_plane = fitted.fit.state.on_plane & (tracks.anchor >= 0)
    count = int(on_plane.sum())
    if count < max(LEAST_TRACKS, LEAST_ON_PLANE * float((tracks.anchor >= 0).sum())):
        return False
    gain = fitted.fit.track_costs - costs_off_plane(fitted.fit)
    return float(gain[on_plane].sum()) <= _chance(count, PLANE_SIGMAS)


def _leaves_plane(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether distances of their own lower the cost beyond chance where the poses may follow.

    Where the parallax is small, a wrong motion can bring the points of any scene near a plane. At these poses distances
    of their own gain little, so the fit without a plane has to be made. The noise is that of this fit: with the plane,
    depth variation would count as noise. A noise below its lower limit is not trusted.
    """
    count = int((fitted.fit.state.on_plane & (tracks.anchor >= 0)).sum())
    left = int((tracks.anchor >= 0).sum()) - count
    of_plane = fitted.fit.cost - OFF_PLANE_COST * left
    # From measured rays: distances that start on the plane gain more, and the level is for those that do not. Only
    # whether the gain exceeds chance is asked.
    start, chance = replace(fitted.motion, plane=None, points=None), _chance(count, VARIATION_SIGMAS)
    free = fit_motion(tracks, start, priors, Limits(hopeless=of_plane - chance))
    gain = of_plane - free.fit.cost
    return not gain / max(free.fit.noise_factor, 1.0) ** 2 <= chance


def _chance(count: int, sigmas: float) -> float:
    """The largest gain that is chance where this number of tracks gets a distance each."""
    return count + sigmas * math.sqrt(2 * count)
