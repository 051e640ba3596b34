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
    LARGEST_VOTE,
    LEAST_TRACKS,
    RARER_BY_SHARE,
    WRONG_DIRECTION_DEG,
    WRONG_ROTATION_DEG,
)
from slam_init.window.locating import locate_views
from slam_init.window.motion import FittedMotion, Motion, farthest_deg, fit_motion
from slam_init.window.tracks import WindowTracks
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

    #: That the camera moves relative to these tracks; 0 where they are few, or have no rigid motion in a pair.
    probability: float = 0.0
    #: (M,) The tracks that have this motion; empty where there is none.
    track_ids: Ints = field(default_factory=lambda: np.zeros(0, int))
    #: Through all views that these tracks locate; None where it was not fitted.
    motion: Motion | None = None


def other_motion(
    hypotheses: WindowHypotheses, rotation_sigma_deg: float = 0.0, direction_sigma_deg: float = 0.0
) -> OtherMotion:
    """Find a rigid motion of the tracks that the best motion does not explain.

    * ``rotation_sigma_deg, direction_sigma_deg``: Standard deviations of the best motion.
    """
    rest = (hypotheses.tracks.anchor >= 0) & ~explained_tracks(hypotheses)
    if rest.sum() < LEAST_TRACKS:
        return OtherMotion()
    search = _Search(
        hypotheses,
        rest,
        WRONG_ROTATION_DEG - GATE_SIGMAS * rotation_sigma_deg,
        WRONG_DIRECTION_DEG - GATE_SIGMAS * direction_sigma_deg,
    )
    found = _proposed(search)
    # The views may not tell the motion again that was found in the window before.
    before = _carried(search)
    return found if before is None or before.probability <= found.probability else before


@dataclass(frozen=True, eq=False)
class _Search:
    """A search for another motion, and what it is weighed by."""

    hypotheses: WindowHypotheses
    #: (T,) The tracks that the best motion does not explain.
    rest: Bools
    #: Angles to the best motion. Where the other motion is nearer, a map by the best one is right.
    same_rotation_deg: float
    same_direction_deg: float


def _carried(search: _Search) -> OtherMotion | None:
    """The motion that was found in the window before, located in this one; None without one."""
    tracks, before = search.hypotheses.tracks, search.hypotheses.other_before
    if before is None or before.points is None:
        return None
    followed = before.points.track_ids[before.points.explained]
    moving = np.flatnonzero(search.rest & np.isin(tracks.track_ids, followed))
    if len(moving) < LEAST_TRACKS:
        return None
    fitted = _fitted_to(search.hypotheses, before, moving)
    return None if fitted is None else _weighed(search, fitted)


def _proposed(search: _Search) -> OtherMotion:
    """The motion of the tracks that the best motion does not explain, by the pair of views that shows most of it."""
    hypotheses, tracks = search.hypotheses, search.hypotheses.tracks
    rays = bearings_of_best(hypotheses)
    pair = _telling_pair(tracks, search.rest & np.isfinite(rays).all(axis=2))
    if pair is None:
        return OtherMotion()
    first, second = pair
    both = search.rest & np.isfinite(rays[list(pair)]).all(axis=(0, 2))
    threshold_rad = GATE_SIGMAS * tracks.noise_px / tracks.camera.focal_px
    pose = estimate_relative_pose(rays[first, both], rays[second, both], threshold_rad=threshold_rad)
    if not isinstance(pose, RelativePose):
        return OtherMotion()
    moving = np.flatnonzero(both)[pose.inliers]
    # Tracks of one plane have two motions in a pair.
    proposed: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    lens = replace(hypotheses.motions[0].motion, plane=None, points=None)
    best = OtherMotion(0.0, tracks.track_ids[moving])
    for one in (one for one in proposed if np.any(one.t)):
        poses = {tracks.frames[first]: Pose.identity(), tracks.frames[second]: Pose(one.R, one.t)}
        fitted = _fitted_to(hypotheses, replace(lens, cam_from_world=poses), moving)
        weighed = OtherMotion() if fitted is None else _weighed(search, fitted)
        best = weighed if weighed.probability > best.probability else best
    return best


def _telling_pair(tracks: WindowTracks, seen: Bools) -> tuple[int, int] | None:
    """The two views whose common tracks tell most of their motion; None where no two have enough of them.

    What tracks tell grows with their number and with the square of the baseline, which grows with the time between two
    views.

    Shapes: ``seen`` (V, T).
    """
    common = seen.astype(int) @ seen.T.astype(int)
    frames = np.array(tracks.frames)
    apart = np.abs(frames[:, None] - frames[None])
    told = np.where(common >= LEAST_TRACKS, common * apart**2, 0)
    first, second = np.unravel_index(int(np.argmax(told)), told.shape)
    return (int(first), int(second)) if told[first, second] else None


def _fitted_to(hypotheses: WindowHypotheses, start: Motion, moving: Ints) -> FittedMotion | None:
    """A motion in the views that some tracks locate, fitted to these; None where they do not locate the reference."""
    tracks = hypotheses.tracks.of_tracks(moving)
    bearings, rotations = bearings_of_best(hypotheses)[:, moving], hypotheses.rotation_only.state.R
    # A body may hide them in the newest view.
    located = locate_views(tracks, start, bearings, rotations, current=False)
    return None if located is None else fit_motion(tracks, located, hypotheses.priors)


def _weighed(search: _Search, fitted: FittedMotion) -> OtherMotion:
    """A motion of some of the tracks, with all tracks that follow it, and the probability that it is the camera's."""
    hypotheses, tracks = search.hypotheses, search.hypotheses.tracks
    more = np.flatnonzero(search.rest | (_votes(hypotheses, fitted) < 0))
    fitted = fit_motion(tracks.of_tracks(more), fitted.motion, hypotheses.priors)
    votes = _votes(hypotheses, fitted)
    others = tracks.track_ids[votes < -LARGEST_VOTE]
    # A motion that explains all tracks is a rival, and shows no body.
    shows_body = min(len(others), int(np.count_nonzero(votes > LARGEST_VOTE))) >= LEAST_TRACKS
    rotation_deg, direction_deg = farthest_deg(hypotheses.motions[0].motion, fitted.motion)
    shows_body &= rotation_deg >= search.same_rotation_deg or direction_deg >= search.same_direction_deg
    return OtherMotion(_probability(hypotheses, votes) if shows_body else 0.0, others, fitted.motion)


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
    """The motion of the camera if the other tracks are at rest; None where these do not locate the pair."""
    frames = hypotheses.tracks.frames
    if other.motion is None or frames[1] not in other.motion.cam_from_world:
        return None
    moving = np.flatnonzero(np.isin(hypotheses.tracks.track_ids, other.track_ids))
    return _fitted_to(hypotheses, other.motion, moving)


def bearings_of_best(hypotheses: WindowHypotheses) -> Floats:
    """The measured rays (V, T, 3) by the lens of the best motion; NaN where a view does not see a track."""
    state, tracks = hypotheses.motions[0].fit.state, hypotheses.tracks
    bearings = tracks.bearings(state.log_scale, state.readout_s, state.k1)
    bearings[~tracks.seen] = np.nan
    return bearings


def _extent(places: Floats) -> float:
    """Area of the ellipse of standard deviations of places (N, 2)."""
    return math.sqrt(max(float(np.linalg.det(np.cov(places.T))), 0.0)) if len(places) > 2 else 0.0
