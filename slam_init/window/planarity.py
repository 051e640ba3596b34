"""Whether the points of a window lie on a plane.

A plane is assumed only where it can be told: a relief would show in the tracks, and no relief shows.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_init.window.equations import OFF_PLANE_COST
from slam_init.window.joint_fit import costs_off_plane, information_of_relief
from slam_init.window.motion import FittedMotion, fit_motion
from slam_init.window.state import Priors
from slam_init.window.tracks import WindowTracks

#: Points lie on a plane if distances of their own lower the cost by as much as noise does: by chi-square with one
#: degree of freedom a track, so by one on average. Their sum may exceed that by this number of standard deviations.
_PLANE_SIGMAS = 2.5
#: The same where the poses follow. A relief of unknown size explains an excess of z standard deviations better than
#: chance does by exp(z^2 / 2), and it has one unknown more, which costs a factor of about three: even odds.
_RELIEF_SIGMAS = 1.5
#: A relief of a fifth of the distances would show by this number of standard deviations, else nothing is known of a
#: plane. The poses follow a smooth relief and hide most of it: of 12 drawn corridors at baselines of .03 and .05 of the
#: depth those that looked like planes had 19 at most; 12 walls and 12 level flights had 40 or more once they were
#: accepted.
_TOLD_RELIEF, _TOLD_SIGMAS, _LARGEST_GAIN = 0.2, 20.0, 9.0
#: Least share of the tracks that a plane holds, and their least number.
_LEAST_ON_PLANE, _LEAST_TRACKS_ON_PLANE = 0.5, 20


def is_plane(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether the points of a fit lie on its plane.

    * Returns: True if a relief would show, and distances of their own gain nothing: neither at the poses of the fit,
      nor where the poses follow.
    """
    return _fits_plane(tracks, fitted, priors) and not _has_relief(tracks, fitted, priors)


def _fits_plane(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether the points of a fit lie on its plane: a relief would show, and distances of their own gain nothing."""
    on_plane = fitted.fit.state.on_plane & (tracks.anchor >= 0)
    count = int(on_plane.sum())
    if count < max(_LEAST_TRACKS_ON_PLANE, _LEAST_ON_PLANE * float((tracks.anchor >= 0).sum())):
        return False
    part = fitted.tracks
    if not _tells_relief(part, fitted, priors):
        return False
    gain = fitted.fit.track_costs - costs_off_plane(part, fitted.fit, priors)
    return _is_chance(float(gain[on_plane].sum()), count, _PLANE_SIGMAS)


def _tells_relief(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether a relief of a fifth of the distances would lower the cost far beyond chance."""
    information = information_of_relief(tracks, fitted.fit, priors)
    gains = np.minimum(_TOLD_RELIEF**2 * information, _LARGEST_GAIN)
    return float(gains.sum()) >= _TOLD_SIGMAS * math.sqrt(2 * max(int((information > 0).sum()), 1))


def _has_relief(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether distances of their own lower the cost beyond chance where the poses may follow.

    Where the parallax is small, a wrong motion can bring the points of any scene near a plane. At these poses distances
    of their own gain little, so the fit without a plane has to be made. The noise is that of this fit: with the plane,
    relief would count as noise. A noise below its lower limit is not trusted.
    """
    count = int((fitted.fit.state.on_plane & (tracks.anchor >= 0)).sum())
    left = int((tracks.anchor >= 0).sum()) - count
    free = fit_motion(tracks, replace(fitted.motion, plane=None), priors)
    gain = fitted.fit.cost - OFF_PLANE_COST * left - free.fit.cost
    return not _is_chance(gain / max(free.fit.noise_factor, 1.0) ** 2, count, _RELIEF_SIGMAS)


def _is_chance(gain: float, count: int, sigmas: float) -> bool:
    """Whether chance lowers the cost by as much where this number of tracks gets a distance each."""
    return gain <= count + sigmas * math.sqrt(2 * count)
