"""Whether the tracks that a motion does not explain have a rigid motion of their own.

Where a body fills a large part of the view, its motion relative to the camera explains as many tracks as the motion of
the scene at rest does. Images alone do not tell which of the two motions is that of the camera. Two cues remain. The
scene at rest mostly holds more tracks than a body does. And a body is compact: a scene that extends around it is behind
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from quest.estimate import RelativePose, estimate_relative_pose
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.pose import Pose
from slam_init.window.equations import explained_at_most
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import EVEN, LEAST_OTHER_TRACKS, OTHER_SIGMAS, SHARE_OF_COMPACT, SHARE_OF_WIDE, WIDE
from slam_init.window.locating import locate_views
from slam_init.window.motion import FittedMotion, fit_motion
from slam_init.window.uncertainty import places_of


def explained_tracks(hypotheses: WindowHypotheses) -> Bools:
    """The tracks that the best motion explains in all views that see them.

    Shapes: returns (T,).
    """
    costs = hypotheses.costs_of(hypotheses.motions[0])
    explained = costs <= explained_at_most(np.maximum(2 * hypotheses.tracks.seen.sum(axis=0) - 3, 0))
    return np.asarray(explained & (hypotheses.tracks.anchor >= 0))


@dataclass(frozen=True, eq=False)
class OtherMotion:
    """A rigid motion of tracks that the best motion does not explain."""

    #: That the camera moves relative to these tracks; 0 where they are few, or have no rigid motion in the pair.
    probability: float = 0.0
    #: (M,) The tracks that have this motion; empty where there is none.
    track_ids: Ints = field(default_factory=lambda: np.zeros(0, int))
    #: ``cam2_from_cam1`` of the pair, if these tracks are at rest.
    pose: Pose = field(default_factory=Pose.identity)


def other_motion(hypotheses: WindowHypotheses) -> OtherMotion:
    """Find a rigid motion of the tracks that the best motion does not explain."""
    tracks, explained = hypotheses.tracks, explained_tracks(hypotheses)
    rays = bearings_of_best(hypotheses)[:2]
    rest = (tracks.anchor >= 0) & ~explained & np.isfinite(rays).all(axis=(0, 2))
    count = int(explained.sum())
    if rest.sum() < max(LEAST_OTHER_TRACKS, SHARE_OF_WIDE * count):
        return OtherMotion()
    threshold_rad = OTHER_SIGMAS * tracks.noise_px / tracks.camera.focal_px
    pose = estimate_relative_pose(rays[0, rest], rays[1, rest], threshold_rad=threshold_rad)
    if not isinstance(pose, RelativePose):
        return OtherMotion()
    places, others = places_of(hypotheses.motions[0].fit), np.flatnonzero(rest)[pose.inliers]
    wide = _extent(places[others]) > WIDE * _extent(places[explained])
    enough = max(LEAST_OTHER_TRACKS, (SHARE_OF_WIDE if wide else SHARE_OF_COMPACT) * count)
    return OtherMotion(EVEN if len(others) >= enough else 0.0, tracks.track_ids[others], Pose(pose.R, pose.t))


def fit_other_motion(hypotheses: WindowHypotheses, other: OtherMotion) -> FittedMotion | None:
    """The motion of the camera if the other tracks are at rest, fitted to these in the views that they locate.

    * Returns: None where it does not locate the pair, or where the camera only rotates then.
    """
    if not other.pose.t.any():
        return None
    tracks, best = hypotheses.tracks, hypotheses.motions[0].motion
    moving = np.flatnonzero(np.isin(tracks.track_ids, other.track_ids))
    pair = {tracks.frames[0]: Pose.identity(), tracks.frames[1]: other.pose}
    start = replace(best, cam_from_world=pair, plane=None, points=None)
    bearings, rotations = bearings_of_best(hypotheses)[:, moving], hypotheses.rotation_only.state.R
    located = locate_views(tracks.of_tracks(moving), start, bearings, rotations)
    return None if located is None else fit_motion(tracks.of_tracks(moving), located, hypotheses.priors)


def bearings_of_best(hypotheses: WindowHypotheses) -> Floats:
    """The measured rays (V, T, 3) by the lens of the best motion; NaN where a view does not see a track."""
    state, tracks = hypotheses.motions[0].fit.state, hypotheses.tracks
    bearings = tracks.bearings(state.log_scale, state.readout_s, state.k1)
    bearings[~tracks.seen] = np.nan
    return bearings


def _extent(places: Floats) -> float:
    """Area of the ellipse of standard deviations of places (N, 2)."""
    return math.sqrt(max(float(np.linalg.det(np.cov(places.T))), 0.0)) if len(places) > 2 else 0.0
