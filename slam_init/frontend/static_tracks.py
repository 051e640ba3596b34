"""Tracks that stay at their pixel while the image moves: they lie on the image and not in the scene.

A time stamp, a logo, a bonnet or dirt on the lens moves with the camera. For a joint fit such tracks are points at
infinity before a camera that does not turn. A wrong motion may explain them together with the scene: where the camera
turns, the scene then moves sideways at one distance. So these tracks take part in no motion.

The flow of a scene is continuous. It is zero at points (the focus of expansion, the axis of a roll) or, at worst, along
a line. Beside a line the flow grows with the distance, so that of the tracks that deviate by less than ``2 a`` one in
two deviates by less than ``a``. On an overlay nearly all of them do. ``k`` of ``n`` such tracks have a probability of
at most ``C(n, k) / 2^k``. Points at infinity before a camera that only translates look the same. Without them the
near points decide on the motion, and at least half of the tracks have to be left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.frame import Observations

#: Static tracks deviate from their first pixel by less than one of these, in pixels: the noise of trackers.
#: Class: assumption.
_STATIC_PX = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
#: They are compared with those that deviate by less than this many times more; a smaller share is expected of a scene.
#: Class: assumption.
_SLOW = 2.0
#: The median track has to deviate by this many times more: the image moves.
#: Class: assumption.
_MOVES = 2.0
#: One false recognition in a thousand sequences of a thousand frames.
#: Class: level.
_LEAST_PROBABILITY = 1e-6
#: A larger share of static tracks is a scene before a camera that hardly turns.
#: Class: assumption.
_LARGEST_SHARE = 0.5


def static_tracks(reference: Observations, current: Observations, further: Sequence[Observations]) -> Ints:
    """The ids of the tracks of a pair that stay at their pixels in all views while the others move.

    Shapes: returns (S,).
    """
    track_ids, deviations_px = _deviations(reference, current, further)
    least, found = math.log(_LEAST_PROBABILITY), track_ids[:0]
    for static_px in _STATIC_PX if len(track_ids) else ():
        static, log_probability = chance_of_static(deviations_px, static_px, _SLOW)
        if np.median(deviations_px) < _MOVES * static_px or static.mean() > _LARGEST_SHARE:
            break
        # The noise of the tracks is not known: the least probable of the sets is the one that holds the whole overlay.
        if log_probability <= least:
            least, found = log_probability, track_ids[static]
    return np.asarray(found)


def chance_of_static(deviations_px: Floats, static_px: float, slow: float) -> tuple[Bools, float]:
    """Which tracks are static, and the logarithm of the probability that as many are in a scene.

    Shapes: ``deviations_px`` (N,), returns ``static`` (N,).

    * ``static_px``: Static tracks deviate by less.
    * ``slow``: They are compared with those that deviate by less than this many times more.
    """
    static = deviations_px < static_px
    k, n = int(static.sum()), int((deviations_px < slow * static_px).sum())
    return static, math.log(math.comb(n, k)) - k * math.log(slow)


def without(view: Observations, track_ids: Ints) -> Observations:
    """A view without some tracks."""
    if not len(track_ids):
        return view
    return view.at(np.flatnonzero(~np.isin(view.track_ids, track_ids)))


def _deviations(reference: Observations, current: Observations, further: Sequence[Observations]) -> tuple[Ints, Floats]:
    """The tracks of a pair, and how far each is at most from its pixel in the reference."""
    track_ids = np.intersect1d(reference.track_ids, current.track_ids, assume_unique=True)
    first = reference.pixels[np.searchsorted(reference.track_ids, track_ids)]
    deviations_px = np.zeros(len(track_ids))
    for view in (current, *further):
        _, at, of = np.intersect1d(track_ids, view.track_ids, assume_unique=True, return_indices=True)
        moved_px = np.linalg.norm(view.pixels[of] - first[at], axis=1)
        deviations_px[at] = np.maximum(deviations_px[at], moved_px)
    return track_ids, deviations_px
