"""The check of the stated focal length: a joint fit of a window that is free of it.

The joint fit of a window holds a stated focal length within its prior. The free fit is that of the same tracks with a
prior that leaves a factor of two open. It begins at the motions of the window, and at those that the pair has at other
focal lengths: a plane or a short baseline leads to a motion that suits a wrong focal length, and no step from there
lowers the cost. The best fit by the likelihood is the estimate. It contradicts the stated focal length where both
differ by more than the errors of the tracks explain, and by more than the prior allows. A window that contradicts it
has no map: with a focal length that is wrong by half, a wrong motion may fit better than the true one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quest.noise import GATE_SIGMAS
from slam_init.decision.evaluated_window import EvaluatedWindow
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.evidence import FreeFocal
from slam_init.types.lens import CALIBRATED_SIGMA
from slam_init.window.hypotheses import WindowHypotheses, fit_hypotheses, motions_at_focal, with_plane
from slam_init.window.motion import Motion
from slam_init.window.risk import likely_lens
from slam_init.window.state import Priors
from slam_init.window.tracks import gain_of_shared_errors

#: Standard deviation of the logarithm of the focal length about a stated one that may be wrong: half or twice as long
#: is off by two deviations. Where the tracks have no information, the free fit stays at the stated focal length.
#: Class: assumption.
_FREE_SIGMA = 0.35
#: Focal lengths over the stated one at which motions are proposed: neighbours differ by as much as the prior leaves
#: open, and a fit moves as far.
#: Class: assumption.
_PROPOSED_AT = (0.5, 0.7, 1.4, 2.0)
#: Two views of a plane look like those of a camera that only rotates, with another focal length.
#: Class: geometry.
_LEAST_VIEWS = 3
#: The estimate contradicts the stated focal length from so many of its deviations on. These hold the errors that the
#: tracks of a view share as if all of them pulled the focal length to one side. Of 399 simulated worlds with a right
#: calibration, two were beyond 1.9, three beyond 1.8 and one beyond 2; of 118 with a wrong one that is significant,
#: 96, 98 and 93 were.
#: Class: measured.
_CONTRADICTS_SIGMAS = 1.9


#: A window that would have a map is not fitted again where the estimate by its tracks alone is within this share of
#: what contradicts the stated focal length. Of 22 simulated windows that contradicted it none was (the nearest one at
#: 0.20), of 139 others 49 %, of 30 on video 63 %; on other seeds none of 8, and 47 of 107.
#: Class: measured.
_AGREES = 0.2


#: The refused windows before this one are too short to determine a focal length, and most starts have a map before it.
#: Class: budget.
_FIRST_REFUSED = 4


class FocalCheck:
    """Checks the stated focal length: in each window that would have a map, and in some of the refused ones.

    These are the fourth, the eighth, the sixteenth and so on, and the last one, at the end. The free fit takes a third
    of the frame with the map. So it is left out where no earlier one contradicts the stated focal length, and the
    tracks agree with it near the best motion.
    """

    def __init__(self) -> None:
        self._refused = 0
        self._contradicted = False
        self._unchecked: EvaluatedWindow | None = None

    def check(self, window: EvaluatedWindow, *, accepted: bool) -> FreeFocal | None:
        """The free fit of a window; None where no check is due.

        * ``accepted``: Whether nothing else refuses a map of the window.
        """
        if window.lens.stated.source in ("prior", "estimated") or len(window.best.rows) < _LEAST_VIEWS:
            return None
        self._refused += not accepted
        is_due = accepted or (self._refused >= _FIRST_REFUSED and self._refused.bit_count() == 1)
        self._unchecked = None if is_due else window
        if not is_due or (accepted and not self._contradicted and _agrees(window)):
            return None
        free = free_focal(window)
        self._contradicted = free is not None and free.contradicts
        return free

    def at_end(self) -> FreeFocal | None:
        """The free fit of the last window, if it was not checked."""
        window, self._unchecked = self._unchecked, None
        return None if window is None else free_focal(window)


def free_focal(window: EvaluatedWindow) -> FreeFocal | None:
    """The focal length by the tracks of a window alone; None where the free fit has no solution."""
    hypotheses, stated = window.hypotheses, window.lens.stated
    priors = replace(hypotheses.priors, focal_sigma=_FREE_SIGMA)
    try:
        with single_threaded():
            motions = [one.motion for one in hypotheses.motions]
            motions += [one for factor in _PROPOSED_AT for one in motions_at_focal(hypotheses, math.log(factor))]
            free = _fit_without_plane(hypotheses, motions, priors)
        if free is None:
            return None
        found = likely_lens(free)
    except np.linalg.LinAlgError:
        return None
    sigma = found.focal_sigma * math.sqrt(1 + gain_of_shared_errors(free.tracks))
    off = window.lens.log_scale + found.mean.log_scale
    least = _contradicts_from(window, sigma)
    estimated_px = stated.focal_px * math.exp(off)
    return FreeFocal(
        stated_px=stated.focal_px,
        estimated_px=estimated_px,
        sigma_px=sigma * estimated_px,
        contradicts=least < abs(off) < GATE_SIGMAS * _FREE_SIGMA,
    )


def _contradicts_from(window: EvaluatedWindow, sigma: float) -> float:
    """How far an estimate of this standard deviation is from the stated focal length to contradict it."""
    return max(GATE_SIGMAS * (window.lens.stated.focal_sigma or CALIBRATED_SIGMA), _CONTRADICTS_SIGMAS * sigma)


def _agrees(window: EvaluatedWindow) -> bool:
    """Whether the tracks agree with the stated focal length near the best motion."""
    by_tracks = window.risk.focal
    sigma = by_tracks.sigma * math.sqrt(1 + gain_of_shared_errors(window.hypotheses.tracks))
    return abs(by_tracks.log_scale) < _AGREES * _contradicts_from(window, sigma)


def _fit_without_plane(
    hypotheses: WindowHypotheses, motions: Sequence[Motion], priors: Priors
) -> WindowHypotheses | None:
    """Fit motions with a distance for each track; the best one with a plane too, where the points lie on it.

    With a wrong focal length a wrong motion can bring the points of any scene near a plane.
    """
    tracks = hypotheses.tracks
    free = fit_hypotheses(
        tracks, [replace(one, plane=None, points=None) for one in motions], priors, hypotheses.rotations
    )
    if free is None or not hypotheses.planar:
        return free
    best = with_plane(replace(free.motions[0].motion, points=None), tracks, free.bearings)
    on_plane = fit_hypotheses(tracks, [best], priors, free.rotations)
    return on_plane if on_plane is not None and on_plane.planar else free
