"""Whether the tracks that a motion does not explain have a rigid motion of their own.

Where a body fills a large part of the view, its motion relative to the camera explains as many tracks as the motion of
the scene at rest does. Images alone do not tell which of the two motions is that of the camera. Two cues remain. The
scene at rest mostly holds more tracks than a body does. And a body is compact: a scene that extends around it is behind
it. Distant tracks and tracks that move by little follow both motions, so that only those count for the other motion
which it explains far better than the best one. A motion that was undecided goes on from window to window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from quest.estimate import Hypothesis, RelativePose, estimate_relative_pose
from quest.noise import GATE_SIGMAS
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.pose import Pose
from slam_init.window.equations import explained_at_most
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.joint_fit import costs_off_plane
from slam_init.window.levels import (
    FLOOR,
    LARGEST_VOTE,
    LEAST_TRACKS,
    RARER_BY_SHARE,
    WRONG_DIRECTION_DEG,
    WRONG_ROTATION_DEG,
)
from slam_init.window.locating import locate_views
from slam_init.window.motion import FittedMotion, Motion, farthest_deg, fit_motion
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
    #: Through all views that these tracks locate; None where it was not fitted.
    motion: Motion | None = None


def other_motion(hypotheses: WindowHypotheses) -> OtherMotion:
    """Find a rigid motion of the tracks that the best motion does not explain."""
    tracks, explained = hypotheses.tracks, explained_tracks(hypotheses)
    rest = (tracks.anchor >= 0) & ~explained
    if rest.sum() < LEAST_TRACKS or _odds(hypotheses, explained.sum(), rest.sum()) < FLOOR:
        return OtherMotion()
    found = _proposed(hypotheses, rest)
    # The pair may not tell the motion again that was found in the window before.
    before = _carried(hypotheses, rest)
    return found if before is None or before.probability <= found.probability else before


def _carried(hypotheses: WindowHypotheses, rest: Bools) -> OtherMotion | None:
    """The motion that was found in the window before, located in this one; None without one."""
    tracks, before = hypotheses.tracks, hypotheses.other_before
    if before is None or before.points is None:
        return None
    followed = before.points.track_ids[before.points.explained]
    moving = np.flatnonzero(rest & np.isin(tracks.track_ids, followed))
    if len(moving) < LEAST_TRACKS:
        return None
    bearings, rotations = bearings_of_best(hypotheses)[:, moving], hypotheses.rotation_only.state.R
    # A body may hide them in the newest view.
    located = locate_views(tracks.of_tracks(moving), before, bearings, rotations, current=False)
    if located is None:
        return None
    return _weighed(hypotheses, fit_motion(tracks.of_tracks(moving), located, hypotheses.priors), rest)


def _proposed(hypotheses: WindowHypotheses, rest: Bools) -> OtherMotion:
    """The motion of the tracks that the best motion does not explain, by the pair.

    Shapes: ``rest`` (T,).
    """
    tracks, rays = hypotheses.tracks, bearings_of_best(hypotheses)[:2]
    rest = rest & np.isfinite(rays).all(axis=(0, 2))
    if rest.sum() < LEAST_TRACKS:
        return OtherMotion()
    threshold_rad = GATE_SIGMAS * tracks.noise_px / tracks.camera.focal_px
    pose = estimate_relative_pose(rays[0, rest], rays[1, rest], threshold_rad=threshold_rad)
    if not isinstance(pose, RelativePose):
        return OtherMotion()
    others = tracks.track_ids[np.flatnonzero(rest)[pose.inliers]]
    if len(others) < LEAST_TRACKS:
        return OtherMotion(0.0, others, Pose(pose.R, pose.t))
    # Tracks of one plane have two motions in a pair.
    proposed: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    starts = [OtherMotion(0.0, others, Pose(one.R, one.t)) for one in proposed]
    fits = [(start, fit_other_motion(hypotheses, start)) for start in starts]
    weighed = [start if fitted is None else _weighed(hypotheses, fitted, rest) for start, fitted in fits]
    return max(weighed, key=lambda other: other.probability)


def _weighed(hypotheses: WindowHypotheses, fitted: FittedMotion, rest: Bools) -> OtherMotion:
    """A motion with all tracks that follow it, and the probability that it is that of the camera.

    * ``rest``: (T,) The tracks that the best motion does not explain. The motion is fitted to some of them.
    """
    tracks = hypotheses.tracks
    more = np.flatnonzero(rest | (_votes(hypotheses, fitted) < 0))
    fitted = fit_motion(tracks.of_tracks(more), fitted.motion, hypotheses.priors)
    votes = _votes(hypotheses, fitted)
    others = tracks.track_ids[votes < -LARGEST_VOTE]
    # A motion that explains all tracks is a rival, and shows no body.
    shows_body = np.count_nonzero(votes > LARGEST_VOTE) >= LEAST_TRACKS
    shows_body &= not _agree(hypotheses.motions[0].motion, fitted.motion)
    probability = _probability(hypotheses, votes) if shows_body else 0.0
    pose = fitted.cam2_from_cam1 if fitted.rows[1] == 1 else Pose.identity()
    return OtherMotion(probability, others, pose, fitted.motion)


def _agree(best: Motion, other: Motion) -> bool:
    """Whether a map by one of two motions is right where that by the other one is, in all views that both know."""
    rotation_deg, direction_deg = farthest_deg(best, other)
    return rotation_deg < WRONG_ROTATION_DEG and direction_deg < WRONG_DIRECTION_DEG


def _votes(hypotheses: WindowHypotheses, other: FittedMotion) -> Floats:
    """The votes (T,) of the tracks for the best motion, against another one at its poses; 0 where neither explains."""
    tracks = hypotheses.tracks
    everywhere = fit_motion(tracks, other.motion, hypotheses.priors, max_steps=0)
    costs = costs_off_plane(everywhere.tracks, everywhere.fit, hypotheses.priors)
    rival = replace(everywhere, fit=replace(everywhere.fit, track_costs=costs))
    bound = explained_at_most(np.maximum(2 * tracks.seen.sum(axis=0) - 3, 0))
    of_best, of_rival = (hypotheses.costs_of(one) for one in (hypotheses.motions[0], rival))
    votes = np.minimum(of_rival, bound) - np.minimum(of_best, bound)
    return np.where(tracks.anchor >= 0, votes, 0.0)


def _probability(hypotheses: WindowHypotheses, votes: Floats) -> float:
    """Probability that the other motion is that of the camera, and the best one that of a body.

    Bodies on the ground at any distance have areas in the image whose density falls with the square of the area.
    """
    of_other = votes < -LARGEST_VOTE
    of_best = explained_tracks(hypotheses) & ~of_other
    places = places_of(hypotheses.motions[0].fit)
    smaller = min(_extent(places[of_other]) / max(_extent(places[of_best]), 1e-300), 1.0)
    odds = _odds(hypotheses, of_best.sum(), of_other.sum()) * smaller**2
    return odds / (1 + odds)


def _odds(hypotheses: WindowHypotheses, of_best: int, of_other: int) -> float:
    """Odds that the best motion is that of a body, by the numbers of tracks that follow it and the other motion."""
    return math.exp(-RARER_BY_SHARE * float(of_best - of_other) / float((hypotheses.tracks.anchor >= 0).sum()))


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
