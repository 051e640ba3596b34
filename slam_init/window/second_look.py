"""A second look at a window whose map is about to be accepted: with free depths, and at motions that were not proposed.

Two gaps are closed here. Both matter for an accepted map only, so a frame that waits does not pay for them.

* **The scene must not vote for a motion.** A wrong motion can bring nearly all points near one plane. Its fit on the
  plane then costs less than that of the right motion, although the right motion explains the tracks better where each
  point has a distance of its own. So all motions are fitted once more with free depths. The plane keeps its precision
  only where both fits agree on the motion.
* **The right motion may not be among the proposals.** quest proposes from one pair, and from most of its matches.
  Further starts are: the motions of the pair at the noise of the window, the conjugate motion of the plane of each
  motion, the motion of the tracks that the best one does not explain (sequential RANSAC), the motion by a second pair,
  and directions of the baseline that are spread over the sphere. Each start is fitted to the pair, and to all views if
  it explains the pair about as well as the best motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from quest.estimate import Hypothesis, RelativePose, estimate_relative_pose
from quest.geometry.quaternion import quaternion_from_matrix
from quest.noise import GATE_SIGMAS
from quest.robust.plane import fit_plane
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose
from slam_init.window.hypotheses import WindowHypotheses, different_optima
from slam_init.window.levels import FAR_BEHIND_IN_PAIR
from slam_init.window.locating import MIN_RESECTED, locate_views
from slam_init.window.motion import FittedMotion, Motion, fit_motion
from slam_init.window.other_motion import bearings_of_best, explained_tracks

#: Steps of a fit with free depths. It starts at the poses of a plane, from where twelve steps left costs of 1675 and
#: 2420 that end at 1207 and 721: the order of the motions turned.
_STEPS = 60
#: Directions of the baseline, in the reference: both ways along its axes.
_DIRECTIONS: Floats = np.vstack([np.eye(3), -np.eye(3)])


def look_again(hypotheses: WindowHypotheses) -> WindowHypotheses:
    """The hypotheses with free depths, and with the motions that further starts lead to; the best first."""
    with single_threaded():
        return _look_again(hypotheses)


def _look_again(hypotheses: WindowHypotheses) -> WindowHypotheses:
    tracks, priors = hypotheses.tracks, hypotheses.priors
    # Fits that were given up as hopeless, or that ran out of steps, are fitted to the end as well.
    starts = [one.motion for one in hypotheses.motions]
    free = [replace(one, plane=None, points=None if hypotheses.planar else one.points) for one in starts]
    fits = [fit_motion(tracks, one, priors, max_steps=_STEPS) for one in free]
    bearings = bearings_of_best(hypotheses)
    for start in _different_starts(hypotheses, fits, bearings):
        located = locate_views(tracks, start, bearings, hypotheses.rotation_only.state.R)
        if located is not None:
            least = min(one.fit.cost for one in fits if len(one.rows) == len(fits[0].rows))
            fits.append(fit_motion(tracks, located, priors, least + 6 * FAR_BEHIND_IN_PAIR, max_steps=_STEPS))
    return replace(hypotheses, planar=False, motions=tuple(different_optima(fits)))


def _different_starts(hypotheses: WindowHypotheses, known: Sequence[FittedMotion], bearings: Floats) -> list[Motion]:
    """The different optima of the pair that further starts lead to and that no known motion is near to."""
    pair = hypotheses.tracks.of_views((0, 1))
    both = np.isfinite(bearings[:2]).all(axis=(0, 2)) & (hypotheses.tracks.anchor == 0)
    if both.sum() < MIN_RESECTED:
        return []
    frames, best = pair.frames, hypotheses.motions[0]
    motions = [replace(one.motion, cam_from_world=_of_pair(one.motion, frames), points=None) for one in known]
    reach = fit_motion(pair, motions[0], hypotheses.priors).fit.cost + FAR_BEHIND_IN_PAIR
    lens = replace(best.motion, plane=None, points=None)
    found: list[Motion] = []
    for pose in _poses_to_start_from(hypotheses, both, bearings):
        start = replace(lens, cam_from_world={frames[0]: Pose.identity(), frames[1]: pose})
        if any(start.is_near(one) for one in [*motions, *found]):
            continue
        fitted = fit_motion(pair, start, hypotheses.priors, reach)
        if fitted.fit.cost <= reach and not any(fitted.motion.is_near(one) for one in [*motions, *found]):
            found.append(replace(fitted.motion, points=None))
    return found


def _of_pair(motion: Motion, frames: tuple[int, ...]) -> dict[int, Pose]:
    return {frame: motion.cam_from_world[frame] for frame in frames[:2]}


def _poses_to_start_from(hypotheses: WindowHypotheses, both: Bools, bearings: Floats) -> Iterator[Pose]:
    """Motions of the pair: conjugates, of all tracks, of other tracks, of a second pair, and in all directions."""
    from quest.robust import kernels

    noise_rad = hypotheses.tracks.noise_px / hypotheses.tracks.camera.focal_px
    m, n = bearings[0, both], bearings[1, both]
    for one in hypotheses.motions:
        pose = one.cam2_from_cam1
        model = np.concatenate([quaternion_from_matrix(pose.R), pose.t])
        for conjugate in fit_plane(model, m, n, noise_rad).poses:
            yield Pose(kernels.rotation_of_model(conjugate), conjugate[4:])
    # The window knows the noise better than the frame that proposed its motions.
    yield from _proposed(m, n, noise_rad)
    rest = both & ~explained_tracks(hypotheses)
    yield from _proposed(bearings[0, rest], bearings[1, rest], noise_rad)
    yield from _by_second_pair(hypotheses, bearings, noise_rad)
    R = hypotheses.rotation_only.state.R[1]
    for direction in _DIRECTIONS:
        yield Pose(R, -R @ direction)


def _by_second_pair(hypotheses: WindowHypotheses, bearings: Floats, noise_rad: float) -> Iterator[Pose]:
    """Motions of the pair whose directions are those of another pair: reference and the view in the middle."""
    frames = np.array(hypotheses.tracks.frames)
    further = [row for row in range(2, len(frames)) if frames[0] < frames[row] < frames[1]]
    if not further:
        return
    middle = further[len(further) // 2]
    both = np.isfinite(bearings[[0, middle]]).all(axis=(0, 2))
    R = hypotheses.rotation_only.state.R[1]
    for pose in _proposed(bearings[0, both], bearings[middle, both], noise_rad):
        yield Pose(R, R @ (pose.R.T @ pose.t))


def _proposed(m: Floats, n: Floats, noise_rad: float) -> Iterator[Pose]:
    """The motion of matches and its alternatives."""
    if len(m) < MIN_RESECTED:
        return
    pose = estimate_relative_pose(m, n, threshold_rad=min(GATE_SIGMAS * noise_rad, 1.0))
    proposed: list[Hypothesis | RelativePose] = [pose, *pose.alternatives] if isinstance(pose, RelativePose) else []
    for one in proposed:
        if np.any(one.t):
            yield Pose(one.R, one.t)
