"""Depths from elsewhere as evidence about the motions of a window. The joint fit does not know them.

A fitted motion states the inverse depths ``x`` of the tracks in a view. The given depths of these tracks are

* ``y = a x`` for inverses of ``metric`` depths and of depths up to ``scale``,
* ``y = a (x + b)`` for ``inverse`` depths, with x over its median; for ``affine`` depths the same with 1 / x,

with an unknown scale ``a``, an unknown shift ``b`` with a prior, and relative errors. The scatter ``s`` of the errors,
over the stated one, is estimated with a heavy tail (Student). Errors of a depth image extend over a part of the image,
so ``n`` parts count and not the tracks; and a network errs alike in all views, so one view counts and not all. With the
stated deviation as a prior of the scatter, worth ``m`` parts, the log likelihood of a motion is

    log L = -(m + n) / 2 * log((m + n s^2) / (m + n)).

That the depth is wrong, and unrelated to the motion, is a hypothesis with a prior probability. So a depth that fits no
motion tells none from another, and one that fits the wrong motion by chance has a bounded vote.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.depth import DepthKind, TrackDepths
from slam_init.window.levels import (
    DEPTH_IS_WRONG,
    LARGEST_DEPTH_VOTE,
    LEAST_TRACKS,
    REGIONS,
    SHIFT_SIGMA,
    STATED_SIGMA_PARTS,
    UNRELATED_DEPTH,
)
from slam_init.window.motion import FittedMotion
from slam_init.window.tracks import WindowTracks

#: Degrees of freedom of Student's distribution of the errors of single tracks: edges of depth, reflections, bodies.
#: Class: assumption.
_TAIL = 3.0
#: Rounds of reweighted least squares: scale and scatter converge linearly, to a hundredth of the scatter in ten.
_ROUNDS = 12
#: Points nearer to infinity than this, over the median inverse depth, count as this far.
#: Class: geometry.
_LEAST_INVERSE = 0.02
#: Shifts that are tried, over the median of the values; the scaled median stays positive.
_SHIFTS = np.linspace(-0.9, 3.0, 40)


@dataclass(frozen=True, eq=False)
class GivenDepths:
    """The given depths of tracks in one view of a window."""

    #: Absolute index of the view.
    frame: int
    #: (N,) Their ids, and their places in the window.
    track_ids: Ints
    at: Ints
    #: (N,) Depths, or inverse depths of the kind ``inverse``.
    values: Floats
    #: (N,) Relative standard deviations.
    sigmas: Floats
    kind: DepthKind
    #: Number of parts of the image that hold tracks with a depth.
    parts: int

    @staticmethod
    def of(tracks: WindowTracks, depths: Sequence[TrackDepths | None]) -> GivenDepths | None:
        """The depths of the first view that has them for enough tracks: mostly the reference.

        * ``depths``: Of each view of the window.
        """
        for row, given in enumerate(depths):
            if given is None:
                continue
            ids, found, in_window = np.intersect1d(given.track_ids, tracks.track_ids, return_indices=True)
            used = np.isfinite(given.values[found]) & tracks.seen[row, in_window] & (tracks.anchor[in_window] >= 0)
            if used.sum() < LEAST_TRACKS:
                continue
            at, of = in_window[used], found[used]
            size = np.array([tracks.camera.width, tracks.camera.height])
            cells = np.clip(tracks.pixels[row, at] / size * REGIONS, 0, np.subtract(REGIONS, 1)).astype(int)
            parts = len(np.unique(cells, axis=0))
            return GivenDepths(tracks.frames[row], ids[used], at, given.values[of], given.sigmas[of], given.kind, parts)
        return None

    def vote(self, best: FittedMotion, rival: FittedMotion) -> float:
        """The vote of the depths for a motion against a rival, in nats: bounded, and 0 where one says nothing."""
        if self.frame not in best.frames or self.frame not in rival.frames:
            return 0.0
        # The same tracks for both: those that neither motion explains have no depth under it.
        used = best.fit.explains[self.at] | rival.fit.explains[self.at]
        if used.sum() < LEAST_TRACKS:
            return 0.0
        unrelated = math.log(DEPTH_IS_WRONG) + self._log_likelihood(
            np.array([UNRELATED_DEPTH / float(np.median(self.sigmas[used]))])
        )
        scores = [
            np.logaddexp(math.log(1 - DEPTH_IS_WRONG) + self._of_motion(one, used), unrelated) for one in (best, rival)
        ]
        return float(np.clip(scores[0] - scores[1], -LARGEST_DEPTH_VOTE, LARGEST_DEPTH_VOTE))

    def _of_motion(self, motion: FittedMotion, used: Bools) -> float:
        """The log likelihood of a motion, over all shifts."""
        inverse = inverse_depths(motion, self.frame, self.track_ids[used])
        inverse = np.maximum(inverse / max(float(np.median(inverse)), 1e-300), _LEAST_INVERSE)
        inverse = np.minimum(inverse, 1 / _LEAST_INVERSE)
        values, sigmas = self.values[used], self.sigmas[used]
        if self.kind in (DepthKind.METRIC, DepthKind.SCALE):
            return self._log_likelihood(_scatters(1 / values, sigmas, inverse[None]))
        stated = inverse if self.kind == DepthKind.INVERSE else 1 / inverse
        scatters = _scatters(values, sigmas, stated + _SHIFTS[:, None])
        prior = -0.5 * (_SHIFTS / SHIFT_SIGMA) ** 2
        each = np.array([self._log_likelihood(scatters[k : k + 1]) for k in range(len(_SHIFTS))]) + prior
        return float(np.logaddexp.reduce(each) - np.logaddexp.reduce(prior))

    def _log_likelihood(self, scatter: Floats) -> float:
        """The log likelihood of one scatter (1,) in units of the stated deviation."""
        parts = STATED_SIGMA_PARTS + self.parts
        return -0.5 * parts * math.log((STATED_SIGMA_PARTS + self.parts * float(scatter[0]) ** 2) / parts)


def inverse_depths(motion: FittedMotion, frame: int, track_ids: Ints) -> Floats:
    """The inverse depths of tracks along the optical axis of a view, in units of the motion; 0 where there is none.

    Shapes: ``track_ids`` (N,), returns (N,).
    """
    carried, k = motion.motion.points, motion.frames.index(frame)
    if carried is None or not len(carried.track_ids):
        return np.zeros(len(track_ids))
    at = np.minimum(np.searchsorted(carried.track_ids, track_ids), len(carried.track_ids) - 1)
    points, inverse = carried.points[at, :3], carried.points[at, 3]
    depth = points @ motion.fit.state.R[k, 2] + inverse * motion.fit.state.t[k, 2]
    ahead = (depth > 0) & (carried.track_ids[at] == track_ids)
    return np.asarray(np.where(ahead, inverse / np.where(ahead, depth, 1.0), 0.0))


def _scatters(values: Floats, sigmas: Floats, stated: Floats) -> Floats:
    """The scatters of relative errors about scaled stated values, in units of their deviations.

    Shapes: ``values, sigmas`` (N,), ``stated`` (M, N), returns (M,).
    """
    # A relative error of a value near 0 would be infinitely precise.
    units = sigmas * np.maximum(np.abs(values), 0.2 * float(np.median(np.abs(values))))
    x, y = stated / units, values / units
    weights, scatter = np.ones_like(x), np.ones((len(x), 1))
    for _ in range(_ROUNDS):
        scale = np.maximum((weights * x * y).sum(axis=1) / np.maximum((weights * x * x).sum(axis=1), 1e-300), 0.0)
        squares = (y - scale[:, None] * x) ** 2
        weights = (_TAIL + 1) / (_TAIL + squares / scatter**2)
        scatter = np.maximum(np.sqrt((weights * squares).mean(axis=1)), 1e-3)[:, None]
    return np.asarray(scatter[:, 0])
