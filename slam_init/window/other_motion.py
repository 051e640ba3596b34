"""Whether tracks that the best motion does not explain have a motion of their own, and are the scene at rest.

Where a moving object fills a large part of the view, its motion relative to the camera explains as many tracks as the
motion of the scene at rest does. Images alone do not show which of the two motions is that of the camera. Two cues
remain. The scene at rest mostly holds more tracks than a moving object does. And a moving object is compact: a scene
that extends around it is behind it. Distant tracks and tracks that move by little follow both motions, so that only
those count for the other motion which it explains far better than the best one.

The other motion is one of four, the most probable one:

* what quest proposes of these tracks in two views, fitted to all views that they locate;
* the other motion of the window before, while its probability exceeds the floor;
* a rotation, where the camera turns or stands before a moving object;
* none, where tracks that stay at their pixel have been left out as an overlay: the camera may stand.

As long as it is found beside a best motion of the same tracks, its probability does not fall. It stays as probable
where its tracks, which only turn, are explained at last: any motion explains them as points at infinity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, RelativePose, estimate_relative_pose
from quest.noise import GATE_SIGMAS
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import Lens
from slam_init.types.pose import Pose
from slam_init.window.arguments import Limits
from slam_init.window.hypotheses import WindowHypotheses, rotating
from slam_init.window.joint_fit import JointFit, costs_off_plane, fit_window
from slam_init.window.levels import (
    FLOOR,
    LARGEST_VOTE,
    LEAST_TRACKS,
    RARER_BY_TRACKS,
    WRONG_DIRECTION_DEG,
    WRONG_ROTATION_DEG,
)
from slam_init.window.locating import align_views, locate_views
from slam_init.window.motion import FittedMotion, Motion, OtherMotion, farthest_deg, fit_motion
from slam_init.window.tracks import WindowTracks
from slam_init.window.uncertainty import places_of


def other_motion(
    hypotheses: WindowHypotheses,
    rotation_sigma_deg: float = 0.0,
    direction_sigma_deg: float = 0.0,
    *,
    seeks: bool = True,
) -> OtherMotion:
    """Find a rigid motion of the tracks that the best motion does not explain.

    * ``rotation_sigma_deg, direction_sigma_deg``: Standard deviations of the best motion.
    * ``seeks``: Whether a new motion is sought beside the one of the window before.
    """
    overlay = _overlay(hypotheses)
    rest = (hypotheses.tracks.anchor >= 0) & ~hypotheses.explained
    if rest.sum() < LEAST_TRACKS:
        return _since_found(hypotheses, overlay)
    search = _Search(
        hypotheses,
        rest,
        WRONG_ROTATION_DEG - GATE_SIGMAS * rotation_sigma_deg,
        WRONG_DIRECTION_DEG - GATE_SIGMAS * direction_sigma_deg,
    )
    # The views may not show the motion again that was found in the window before.
    found = [_from_last_window(search), overlay]
    if seeks:
        found = [_proposed(search), _rotation(search), *found]
    return _since_found(hypotheses, max(found, key=lambda other: other.probability))


def _since_found(hypotheses: WindowHypotheses, found: OtherMotion) -> OtherMotion:
    """The same motion, at least as probable as it was in earlier windows beside a best motion of the same tracks.

    A moving object that comes nearer hides tracks of the scene, and tracks end. The odds fall with their number, while
    nothing has shown which of the two motions is that of the camera.
    """
    ids, explained = hypotheses.tracks.track_ids, hypotheses.explained
    found = replace(found, of_best=ids[explained & ~np.isin(ids, found.track_ids)])
    before = hypotheses.other_before
    if before is None or 2 * np.count_nonzero(np.isin(ids[explained], before.of_best)) < explained.sum():
        return found
    if found.probability > FLOOR:
        return replace(found, probability=max(found.probability, before.probability))
    theirs = np.flatnonzero(np.isin(ids, before.track_ids) & (hypotheses.tracks.anchor >= 0))
    return replace(before, fitted=None) if _only_turn(hypotheses, theirs) else found


def _only_turn(hypotheses: WindowHypotheses, some: Ints) -> bool:
    """Whether a camera that only rotates explains most of some tracks: any motion with its rotations does too."""
    if len(some) < LEAST_TRACKS:
        return False
    costs = _costs_of_rotation(hypotheses.tracks.of_tracks(some), _rotation_by(hypotheses, some))
    return bool(2 * np.count_nonzero(costs <= hypotheses.largest_costs[some]) > len(some))


@dataclass(frozen=True, eq=False)
class _Search:
    """A search for another motion, and what it is weighed by."""

    hypotheses: WindowHypotheses
    #: (T,) The tracks that the best motion does not explain.
    rest: Bools
    #: Angles to the best motion. Where the other motion is nearer, a map by the best one is right.
    same_rotation_deg: float
    same_direction_deg: float


def _from_last_window(search: _Search) -> OtherMotion:
    """The motion that was found in the window before, located in this one."""
    tracks, before = search.hypotheses.tracks, search.hypotheses.other_before
    motion = None if before is None or before.fitted is None else before.fitted.motion
    if motion is None or motion.points is None:
        return OtherMotion()
    followed = motion.points.track_ids[motion.points.explained]
    moving = np.flatnonzero(search.rest & np.isin(tracks.track_ids, followed))
    if len(moving) < LEAST_TRACKS:
        return OtherMotion()
    fitted = _fitted_to(search.hypotheses, motion, moving)
    return OtherMotion() if fitted is None else _weighed(search, fitted)


def _proposed(search: _Search) -> OtherMotion:
    """The motion of the tracks that the best motion does not explain, by the pair of views that shows most of it."""
    hypotheses, tracks, rays = search.hypotheses, search.hypotheses.tracks, search.hypotheses.bearings
    rows = _most_informative_pair(tracks, search.rest & np.isfinite(rays).all(axis=2))
    if rows is None:
        return OtherMotion()
    first, second = rows
    both = search.rest & np.isfinite(rays[list(rows)]).all(axis=(0, 2))
    threshold_rad = GATE_SIGMAS * tracks.noise_px / tracks.camera.focal_px
    pose = estimate_relative_pose(rays[first, both], rays[second, both], threshold_rad=threshold_rad)
    if not isinstance(pose, RelativePose):
        return OtherMotion()
    moving = np.flatnonzero(both)[pose.inliers]
    start = replace(hypotheses.motions[0].motion, plane=None, points=None)
    # Tracks of one plane have two motions.
    proposed: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    frame1, frame2 = tracks.frames[first], tracks.frames[second]
    poses = [{frame1: Pose.identity(), frame2: Pose(one.R, one.t)} for one in proposed if np.any(one.t)]
    fits = [_fitted_to(hypotheses, replace(start, cam_from_world=pair), moving) for pair in poses]
    weighed = [_weighed(search, fit) for fit in fits if fit is not None]
    return max(weighed, key=lambda other: other.probability, default=OtherMotion())


def _rotation(search: _Search) -> OtherMotion:
    """The case that the camera only rotates, by the tracks off the best motion, which is that of a moving object."""
    hypotheses = search.hypotheses
    fit = _rotation_by(hypotheses, np.flatnonzero(search.rest))
    votes = _votes(hypotheses, _costs_of_rotation(hypotheses.tracks, fit))
    others = votes < -LARGEST_VOTE
    if min(others.sum(), (votes > LARGEST_VOTE).sum()) < LEAST_TRACKS:
        return OtherMotion()
    return OtherMotion(_probability(hypotheses, others), hypotheses.tracks.track_ids[others])


def _rotation_by(hypotheses: WindowHypotheses, some: Ints) -> JointFit:
    """The camera that only rotates, by some of the tracks, from the stated lens."""
    tracks, fit = hypotheses.tracks.of_tracks(some), hypotheses.rotation_only
    lens = Lens(readout_s=fit.state.lens.readout_s)
    R = align_views(tracks.bearings(lens), [hypotheses.motions[0].motion], tracks.frames[:2])
    return fit_window(tracks, rotating(tracks, R, lens), fit.priors, rotation_only=True)


def _costs_of_rotation(tracks: WindowTracks, fit: JointFit) -> Floats:
    """The costs of some tracks in a camera that only rotates, as others have located it."""
    start = rotating(tracks, fit.state.R, fit.state.lens)
    return fit_window(tracks, start, fit.priors, rotation_only=True, limits=Limits(max_steps=0)).track_costs


def _overlay(hypotheses: WindowHypotheses) -> OtherMotion:
    """The camera stands by the tracks that stay at their pixel, and the best motion is that of a moving object.

    These tracks are left out of the window, as those of an overlay (:mod:`slam_init.frontend.static_tracks`).
    """
    overlay = hypotheses.overlay
    if overlay is None or len(overlay.rays) < LEAST_TRACKS:
        return OtherMotion()
    used = float((hypotheses.tracks.anchor >= 0).sum())
    count, explained = used * overlay.share / (1 - overlay.share), hypotheses.explained
    places = np.arctan2(overlay.rays[:, :2], overlay.rays[:, 2:])
    of_best = _extent(places_of(hypotheses.motions[0].fit)[explained])
    probability = _probability_of_object(count / max(int(explained.sum()), 1), _extent(places), of_best)
    return OtherMotion(probability, overlay.track_ids)


def _most_informative_pair(tracks: WindowTracks, seen: Bools) -> tuple[int, int] | None:
    """The two views whose common tracks are the most informative; None where no two have enough of them.

    The information of tracks grows with their number and with the square of the baseline, which grows with the time
    between two views.

    Shapes: ``seen`` (V, T).
    """
    common = seen.astype(int) @ seen.T.astype(int)
    frames = np.array(tracks.frames)
    apart = np.abs(frames[:, None] - frames[None])
    weight = np.where(common >= LEAST_TRACKS, common * apart**2, 0)
    first, second = np.unravel_index(int(np.argmax(weight)), weight.shape)
    return (int(first), int(second)) if weight[first, second] else None


def _fitted_to(hypotheses: WindowHypotheses, start: Motion, moving: Ints) -> FittedMotion | None:
    """A motion in the views that some tracks locate, fitted to these; None where they do not locate the reference."""
    tracks = hypotheses.tracks.of_tracks(moving)
    bearings, rotations = hypotheses.bearings[:, moving], hypotheses.rotation_only.state.R
    # A moving object may hide them in the newest view.
    located = locate_views(tracks, start, bearings, rotations, current=False)
    return None if located is None else fit_motion(tracks, located, hypotheses.priors)


def _weighed(search: _Search, fitted: FittedMotion) -> OtherMotion:
    """A motion of some of the tracks, with all tracks that follow it, and the probability that it is the camera's."""
    hypotheses, tracks = search.hypotheses, search.hypotheses.tracks
    more = np.flatnonzero(search.rest | (_votes(hypotheses, costs_at(hypotheses, fitted.motion)) < 0))
    fitted = fit_motion(tracks.of_tracks(more), fitted.motion, hypotheses.priors)
    votes = _votes(hypotheses, costs_at(hypotheses, fitted.motion))
    others = votes < -LARGEST_VOTE
    # A motion that explains all tracks is a competing motion, and shows no moving object.
    shows_object = min(others.sum(), (votes > LARGEST_VOTE).sum()) >= LEAST_TRACKS
    rotation_deg, direction_deg = farthest_deg(hypotheses.motions[0].motion, fitted.motion)
    shows_object &= rotation_deg >= search.same_rotation_deg or direction_deg >= search.same_direction_deg
    return OtherMotion(_probability(hypotheses, others) if shows_object else 0.0, tracks.track_ids[others], fitted)


def _votes(hypotheses: WindowHypotheses, costs: Floats) -> Floats:
    """The votes (T,) of the tracks for the best motion, against one with these costs (T,); 0 where neither explains."""
    of_best, bound = hypotheses.costs_of(hypotheses.motions[0]), hypotheses.largest_costs
    return np.where(hypotheses.tracks.anchor >= 0, np.minimum(costs, bound) - np.minimum(of_best, bound), 0.0)


def costs_at(hypotheses: WindowHypotheses, motion: Motion) -> Floats:
    """The cost (T,) of each track in all views at the poses of a motion, each with a distance of its own."""
    everywhere = fit_motion(hypotheses.tracks, motion, hypotheses.priors, Limits(max_steps=0))
    costs = costs_off_plane(everywhere.fit)
    return hypotheses.costs_of(replace(everywhere, fit=replace(everywhere.fit, track_costs=costs)))


def _probability(hypotheses: WindowHypotheses, of_other: Bools) -> float:
    """Probability that the motion of some tracks (T,) is that of the camera, and the best one that of an object."""
    places, of_best = places_of(hypotheses.motions[0].fit), hypotheses.explained & ~of_other
    tracks = int(of_other.sum()) / max(int(of_best.sum()), 1)
    return _probability_of_object(tracks, _extent(places[of_other]), _extent(places[of_best]))


def _probability_of_object(tracks: float, of_other: float, of_best: float) -> float:
    """Probability that a motion is that of a moving object.

    Moving objects on the ground at any distance have areas in the image whose density falls with the square of the
    area.

    * ``tracks``: The tracks of the other motion for each one that it has.
    * ``of_other, of_best``: Areas of the other motion and of this one.
    """
    odds = math.pow(tracks, RARER_BY_TRACKS) * min(of_other / max(of_best, 1e-300), 1.0) ** 2
    return odds / (1 + odds)


def _extent(places: Floats) -> float:
    """Area of the ellipse of standard deviations of places (N, 2)."""
    return math.sqrt(max(float(np.linalg.det(np.cov(places.T))), 0.0)) if len(places) > 2 else 0.0
