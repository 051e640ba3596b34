"""The hypotheses of a window, each with one joint fit of all its views.

A hypothesis is a :class:`~slam_init.window.motion.Motion`: the poses of some views, and a plane where most points lie
on one. quest proposes the motions of a pair. A motion is carried to all views of the window: its points locate the
views that it does not know (:mod:`~slam_init.window.locating`), then everything is fitted jointly. The fitted motion
knows all views, so it is the start of the next fit, when a frame has arrived.

Whether the points lie on a plane is a property of the scene, so it is decided for the whole window: all motions are
fitted with a plane, and without one if the best of them does not pass the test of its plane
(:mod:`~slam_init.window.planarity`).

A camera that only rotates is the hypothesis that each motion has to beat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from quest.estimate import Hypothesis, NoPose, RelativePose, estimate_relative_pose
from quest.noise import GATE_SIGMAS
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import UNKNOWN_K1_SIGMA, UNKNOWN_PRINCIPAL_SIGMA, Lens
from slam_init.types.pose import Pose
from slam_init.window.arguments import Limits
from slam_init.window.equations import explained_at_most
from slam_init.window.joint_fit import JointFit, fit_window, start_noise_factor
from slam_init.window.levels import LARGEST_VOTE, UNDECIDED, WRONG_FOCAL, WRONG_FOCAL_COST
from slam_init.window.locating import MIN_RESECTED, align_views, locate_views
from slam_init.window.motion import FittedMotion, Motion, OtherMotion, fit_motion, noise_factor_at
from slam_init.window.planarity import is_plane, plane_of_motion
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tracks import WindowTracks, gain_of_lasting_errors, gain_of_shared_errors, gain_of_turning_errors
from slam_init.window.uncertainty import ExpandedFit, expand

#: The window is fitted again where the noise was off by more than this factor (as a logarithm): the standard deviations
#: are off by as much. With another noise other observations are outliers, hence the rounds.
_NOISE_TOLERANCE, _NOISE_ROUNDS = 0.07, 2
#: A proposal beside a living motion is given up if it costs this many times what is hopeless after its first step:
#: later steps of starts that ended below gained a third of their cost at most.
_GIVEN_UP = 1.5
#: A motion whose cost is higher by this cannot become the best: 300 nats.
#: Class: level, in twice the nats.
FAR_BEHIND = 600.0
#: A gain is certain where it exceeds that by chance by so many standard deviations (one in 10^12) even if fields of
#: correlated errors explain half of it, the most that they can.
#: Class: level.
CERTAIN_SIGMAS, EXPLAINED_BY_FIELDS = 7.0, 0.5
#: A start whose residuals are this many times the noise is far from the answer.
_FAR_FACTOR = 1.5


@dataclass(frozen=True, eq=False)
class OverlayTracks:
    """Static overlay: tracks of a pair that stay at their pixels while the others move."""

    track_ids: Ints
    #: (S, 3) Their rays in the reference.
    rays: Floats
    #: Their share of the matches of the pair.
    share: float


@dataclass(frozen=True, eq=False)
class WindowHypotheses:
    """The fitted hypotheses of a window."""

    tracks: WindowTracks
    #: Whether most points are held on a plane.
    planar: bool
    #: Different optima only, the best first: those that locate more views first, then by their cost.
    motions: tuple[FittedMotion, ...]
    #: The camera that only rotates. By its priors, the focal length may be wrong.
    rotation_only: JointFit
    #: Of the fits of the motions.
    priors: Priors
    #: Where the fits of the camera that only rotates ended: with any focal length, then, where it was fitted, with the
    #: stated one.
    rotations: tuple[Motion, ...] = ()
    #: The rigid motion that tracks had beside the best one in the window before; None without one.
    other_before: OtherMotion | None = None
    #: The tracks that are left out since they stay at their pixel; None without them.
    overlay: OverlayTracks | None = None

    @cached_property
    def expanded(self) -> ExpandedFit:
        """The expansion of the cost about the best motion."""
        return expand(self.motions[0])

    @property
    def largest_costs(self) -> Floats:
        """The largest cost (T,) of a track, in all views that see it, that a motion explains."""
        return explained_at_most(np.maximum(2 * self.tracks.seen.sum(axis=0) - 3, 0))

    def costs_of(self, motion: FittedMotion) -> Floats:
        """The cost of each track in all views; a view that a motion does not locate sees outliers.

        Shapes: returns (T,).
        """
        seen = self.tracks.seen
        missing = seen.sum(axis=0) - seen[list(motion.rows)].sum(axis=0)
        return np.asarray(motion.fit.track_costs + self.priors.gate_sigmas**2 * missing)

    @property
    def explained(self) -> Bools:
        """The tracks that the best motion explains in all views that see them.

        Shapes: returns (T,).
        """
        return np.asarray((self.costs_of(self.motions[0]) <= self.largest_costs) & (self.tracks.anchor >= 0))

    @property
    def bearings(self) -> Floats:
        """The measured rays (V, T, 3) by the lens of the best motion; NaN where a view does not see a track."""
        return self.tracks.bearings(self.motions[0].fit.state.lens.centred())

    def votes(self, motion: FittedMotion, other: FittedMotion) -> Floats:
        """The votes of the tracks for a motion against another one: differences of bounded costs.

        Shapes: returns (T,).
        """
        return self._votes(self.costs_of(motion), self.costs_of(other))

    def _votes(self, costs: Floats, of_other: Floats) -> Floats:
        # Tracks that neither motion explains must not vote.
        bound = self.largest_costs + (LARGEST_VOTE if self.planar else 0.0)
        votes = np.minimum(of_other, bound) - np.minimum(costs, bound)
        return np.asarray(np.clip(votes, -LARGEST_VOTE, LARGEST_VOTE))

    @property
    def gain_beyond_votes(self) -> float:
        """The gain over the rotation-only camera (nats) by tracks on the plane, beyond their votes."""
        best = self.motions[0]
        used = best.fit.state.on_plane & (self.tracks.anchor >= 0)
        costs, of_rotation = self.costs_of(best), self.rotation_only.track_costs
        return 0.5 * float((of_rotation - costs - self._votes(costs, of_rotation))[used].sum())

    @property
    def gain_over_rotation(self) -> tuple[float, float]:
        """Log likelihood of the best motion over the rotation-only camera (nats), and the degrees of freedom of it.

        Translation and points lower the cost by chance too: twice the gain has a chi-square distribution then. Tracks
        off the plane are left out: a track that drifts leaves the plane and gains as much as a near point.
        """
        best, seen = self.motions[0], self.tracks.seen
        missing = int(seen.sum()) - int(seen[list(best.rows)].sum())
        lowered = self.rotation_only.cost - best.fit.cost - self.priors.gate_sigmas**2 * missing
        if self.planar:
            off = ~best.fit.state.on_plane & (self.tracks.anchor >= 0)
            lowered -= float((self.rotation_only.track_costs - self.costs_of(best))[off].sum())
        # A distance is not negative, so that by chance half of the tracks gain nothing. But without a translation its
        # direction is chosen to suit the tracks, and outliers gain more than noise: 0.9 a track in 32 simulated
        # windows.
        points = 3.0 if self.planar else float((self.tracks.anchor >= 0).sum())
        return 0.5 * lowered, 3 * (len(best.rows) - 1) - 1 + points


def motions_of_pair(
    pose: RelativePose, frames: tuple[int, ...], rays1: Floats, rays2: Floats, readout_s: float = 0.0
) -> list[Motion]:
    """The motions that explain the matches of a pair.

    Shapes: ``rays1, rays2`` (N, 3).

    * ``frames``: The pair first.
    * ``pose``: ``cam2_from_cam1`` with its alternatives. If its kind is "rotation", only the alternatives have a
      translation. They are worth trying where a rotation-only camera would show as much parallax once in twenty pairs.
      So little parallax shows no depth variation either: the points start on a plane then.
    """
    proposed: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    chance = pose.evidence.parallax_p
    if pose.kind == "rotation" and (chance is None or chance > UNDECIDED):
        return []
    motions = []
    for one in proposed:
        if not np.any(one.t):
            continue
        plane = None
        if pose.kind != "general" and one.inliers.sum() >= MIN_RESECTED:
            plane = plane_of_motion(one.R, one.t, rays1[one.inliers], rays2[one.inliers])
        poses = {frames[0]: Pose.identity(), frames[1]: Pose(one.R, one.t)}
        motions.append(Motion(poses, plane, Lens(readout_s=readout_s)))
    return motions


def motions_at_focal(hypotheses: WindowHypotheses, log_scale: float) -> list[Motion]:
    """The motions of the pair as quest proposes them at another focal length, in all views that they locate.

    * ``log_scale``: Logarithm of this focal length over that of the current lens.
    """
    tracks, R = hypotheses.tracks, hypotheses.rotation_only.state.R
    lens = Lens(log_scale, readout_s=tracks.readout_s)
    bearings = tracks.bearings(lens)
    m, n = bearings[:2, np.isfinite(bearings[:2]).all(axis=(0, 2))]
    noise_rad = tracks.noise_px / (tracks.camera.focal_px * math.exp(log_scale))
    pose = estimate_relative_pose(m, n, threshold_rad=min(GATE_SIGMAS * noise_rad, 1.0))
    motions = [] if isinstance(pose, NoPose) else motions_of_pair(pose, tracks.frames[:2], m, n)
    located = (locate_views(tracks, replace(one, lens=lens), bearings, R) for one in motions)
    return [one for one in located if one is not None]


def fit_hypotheses(
    tracks: WindowTracks, motions: Sequence[Motion], priors: Priors, living: Sequence[Motion] = ()
) -> WindowHypotheses | None:
    """Fit motions, and the rotation-only camera, to all views of a window.

    * ``tracks``: Views: reference, current, then further ones. Their noise is measured again by the residuals of the
      best motion.
    * ``motions``: Each knows two of the views or more. Those that know more come first: a later one that is near is
      left out.
    * ``living``: Where the last fits of the camera that only rotates ended (:attr:`WindowHypotheses.rotations`); by
      default it is fitted again.
    """
    first = motions[0] if motions else Motion({}, lens=Lens(readout_s=tracks.readout_s))
    bearings = tracks.bearings(_with_stated_focal(first.lens))
    rotations = align_views(bearings, motions, tracks.frames[:2])
    poses: list[Motion] = []
    for motion in motions:
        if any(motion.is_near(known) for known in poses):
            continue
        located = locate_views(tracks, motion, bearings, rotations)
        if located is not None:
            poses.append(located)
    if not poses:
        return None
    if poses[0].points is None:
        tracks = tracks.with_noise(tracks.noise_px * noise_factor_at(tracks, poses[0], priors))
    planar, fits = _fitted(tracks, poses, bearings, priors)
    for _ in range(_NOISE_ROUNDS):
        noise_px = max(fits[0].fit.noise_factor * tracks.noise_px, tracks.least_noise_px)
        if abs(math.log(noise_px / tracks.noise_px)) <= _NOISE_TOLERANCE:
            break
        tracks = tracks.with_noise(noise_px)
        planar, fits = _fitted(tracks, [one.motion for one in fits], bearings, priors)
    starts = tuple(_in_window(tracks, one, rotations) for one in living)
    rotation_only, ends = _fit_rotation(tracks, rotations, priors, fits[0], starts)
    return WindowHypotheses(tracks, planar, tuple(fits), rotation_only, priors, ends)


def with_rotation_refitted(hypotheses: WindowHypotheses) -> WindowHypotheses:
    """The same hypotheses with the camera that only rotates fitted from afar."""
    tracks, best = hypotheses.tracks, hypotheses.motions[0]
    bearings = tracks.bearings(_with_stated_focal(best.fit.state.lens))
    rotations = align_views(bearings, [best.motion], tracks.frames[:2])
    rotation_only, ends = _fit_rotation(tracks, rotations, hypotheses.priors, best)
    return replace(hypotheses, rotation_only=rotation_only, rotations=ends)


def _fitted(
    tracks: WindowTracks, motions: Sequence[Motion], bearings: Floats, priors: Priors
) -> tuple[bool, list[FittedMotion]]:
    """Whether the points lie on a plane, and the different optima of located motions, the best first."""
    if any(motion.plane is not None for motion in motions):
        on_plane = [with_plane(motion, tracks, bearings) for motion in motions]
        fits = different_optima(_fit_each(tracks, on_plane, priors))
        if is_plane(tracks, fits[0], priors):
            return True, fits
    return False, different_optima(_fit_each(tracks, [replace(motion, plane=None) for motion in motions], priors))


def _fit_each(tracks: WindowTracks, motions: Sequence[Motion], priors: Priors) -> list[FittedMotion]:
    """Fit motions; those that stay far behind an earlier one in the same views are not fitted to the end."""
    fits: list[FittedMotion] = []
    for motion in motions:
        same = [one for one in fits if set(one.frames) == set(motion.cam_from_world)]
        hopeless = min((one.fit.cost for one in same), default=math.inf) + FAR_BEHIND
        give_up = math.inf if all(one.is_new for one in same) else _GIVEN_UP * hopeless
        fits.append(fit_motion(tracks, motion, priors, Limits(hopeless=hopeless, give_up=give_up)))
    return fits


def different_optima(fits: list[FittedMotion]) -> list[FittedMotion]:
    """The different optima, the best first."""
    different: list[FittedMotion] = []
    for fitted in sorted(fits, key=lambda fitted: (-len(fitted.rows), fitted.fit.cost)):
        if not any(fitted.same_as(kept) for kept in different):
            different.append(fitted)
    return different


def with_plane(motion: Motion, tracks: WindowTracks, bearings: Floats) -> Motion:
    """A located motion with the plane that explains most of its matches, where it has none yet."""
    if motion.plane is not None:
        return motion
    # A bent camera has no ray for a pixel beyond the radius at which its lens stops growing.
    both = np.isfinite(bearings[:2]).all(axis=(0, 2))
    if both.sum() < MIN_RESECTED:
        return motion
    pose = motion.cam_from_world[tracks.frames[1]]
    return replace(motion, plane=plane_of_motion(pose.R, pose.t, bearings[0, both], bearings[1, both]))


def _fit_rotation(
    tracks: WindowTracks, rotations: Floats, priors: Priors, best: FittedMotion, living: Sequence[Motion] = ()
) -> tuple[JointFit, tuple[Motion, ...]]:
    """The better fit of the camera that only rotates, with a right or with a wrong focal length; where fits ended."""
    # A focal length that is no calibration may be wrong at no price.
    unknown = priors.focal_sigma >= WRONG_FOCAL
    any_focal = replace(
        priors, focal_sigma=max(WRONG_FOCAL, priors.focal_sigma), k1_sigma=max(UNKNOWN_K1_SIGMA, priors.k1_sigma)
    )
    lens = Lens(readout_s=tracks.readout_s)
    start = None if living else approached(tracks, rotating(tracks, rotations, lens), any_focal)
    # Far from the answer the principal point would follow outliers.
    any_focal = replace(any_focal, principal_sigma_px=UNKNOWN_PRINCIPAL_SIGMA * tracks.camera.width)
    hopeless = _hopeless_rotation(tracks, rotations, priors, best)
    wrong = _fit_turning(tracks, living[0] if start is None else start, any_focal, hopeless)
    ends = [_turning_motion(wrong)]
    wrong = replace(wrong, cost=wrong.cost + (0.0 if unknown else WRONG_FOCAL_COST))
    if unknown or wrong.cost > hopeless:
        return wrong, tuple(ends)
    # It is the better one only if it costs less.
    right = _fit_turning(tracks, living[1] if len(living) > 1 else wrong.state, priors, wrong.cost)
    ends.append(_turning_motion(right))
    return (right if right.cost <= wrong.cost else wrong), tuple(ends)


def approached(tracks: WindowTracks, start: WindowState, priors: Priors) -> WindowState:
    """A camera that only rotates, from a start that may be off by many times the noise: near its answer.

    A wrong focal length moves the tracks so far. The first fits have a noise that allows it.
    """
    factor = start_noise_factor(tracks, start, priors, rotation_only=True)
    for wider in (factor, math.sqrt(factor)) if factor > _FAR_FACTOR else ():
        wide = tracks.with_noise(wider * tracks.noise_px)
        start = fit_window(wide, start, priors, rotation_only=True).state
    return start


def _fit_turning(tracks: WindowTracks, start: WindowState | Motion, priors: Priors, hopeless: float) -> JointFit:
    """Fit a camera that only rotates, from the poses and the lens of a state, or from where an earlier fit ended."""
    if isinstance(start, WindowState):
        R, points, lens = start.R, None, start.lens.centred()
    else:
        R, points, lens = np.array([start.cam_from_world[frame].R for frame in tracks.frames]), start.points, start.lens
    first = rotating(tracks, R, lens)
    known = None if points is None else points.start(tracks, first)
    return fit_window(tracks, first, priors, known=known, rotation_only=True, limits=Limits(hopeless=hopeless))


def _with_stated_focal(lens: Lens) -> Lens:
    """A lens with the stated focal length and principal point."""
    return Lens(k1=lens.k1, readout_s=lens.readout_s)


def rotating(tracks: WindowTracks, R: Floats, lens: Lens) -> WindowState:
    """A camera that only rotates, with rays as measured.

    Shapes: ``R`` (V, 3, 3).
    """
    # Translations have no effect on points at infinity; their length only has to differ from zero.
    return start_at(tracks, R, np.outer(np.arange(len(R)), [1e-9, 0.0, 0.0]), lens=lens, at_infinity=True)


def _turning_motion(fit: JointFit) -> Motion:
    """Where a fit of a camera that only rotates ended."""
    return FittedMotion(fit, tuple(range(len(fit.tracks.frames)))).motion


def _in_window(tracks: WindowTracks, motion: Motion, rotations: Floats) -> Motion:
    """A rotation-only motion in the views of a window: those that it does not know turn as the tracks do."""
    known = {row: pose.R for row, pose in motion.known_in(tracks).items()}
    turned = dict(known)
    for row in set(range(len(tracks.frames))) - set(known):
        nearest = min(known, key=lambda one: abs(tracks.frames[one] - tracks.frames[row]), default=None)
        turned[row] = rotations[row] if nearest is None else rotations[row] @ rotations[nearest].T @ known[nearest]
    world = turned[0]
    poses = {frame: Pose(turned[row] @ world.T, np.zeros(3)) for row, frame in enumerate(tracks.frames)}
    points = None if motion.points is None or not known else motion.points.moved(Pose(world, np.zeros(3)))
    return replace(motion, cam_from_world=poses, points=points)


def _hopeless_rotation(tracks: WindowTracks, rotations: Floats, priors: Priors, best: FittedMotion) -> float:
    """The cost from which on the best motion is certain to gain more than by chance over a camera that only rotates."""
    explained = np.zeros_like(tracks.seen)
    explained[list(best.rows)] = best.fit.state.on_plane if best.fit.state.plane is not None else True
    outliers = tracks.seen & ~explained
    freedom = 3 * len(best.rows) + int((tracks.anchor >= 0).sum())
    by_chance = freedom + 2 * (
        gain_of_shared_errors(tracks) + gain_of_turning_errors(tracks, best.fit.state.lens.readout_s)
    )
    by_chance *= best.fit.dispersion * gain_of_lasting_errors(tracks, rotations)
    # The tail of chi-square by Wilson and Hilferty.
    certain = (1 + CERTAIN_SIGMAS * math.sqrt(2 / (9 * freedom))) ** 3 / EXPLAINED_BY_FIELDS
    return best.fit.cost + priors.gate_sigmas**2 * int(outliers.sum()) + certain * by_chance
