"""The hypotheses of a window, each with one joint fit of all its views.

A hypothesis is a :class:`Motion`: the poses of some views, and a plane where most points lie on one. quest proposes the
motions of a pair. A motion is carried to all views of the window: its points locate the views that it does not know,
then everything is fitted jointly. The fitted motion knows all views, so it is the start of the next fit, when a frame
has arrived.

Whether the points lie on a plane is a property of the scene, so it is decided for the whole window: all motions are
fitted with a plane, and without one if the best of them does not pass the test of its plane.

A camera that only rotates is the hypothesis that each motion has to beat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, RelativePose
from quest.geometry.quaternion import rotation_angle
from quest.robust.rotation import refine_rotation_compiled
from slam_init.mapping.plane import plane_of_motion
from slam_init.mapping.triangulation import resect, triangulate
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose
from slam_init.window.equations import OFF_PLANE_COST
from slam_init.window.joint_fit import (
    JointFit,
    costs_off_plane,
    fit_window,
    information_of_relief,
    start_noise_factor,
)
from slam_init.window.state import Priors, start_at
from slam_init.window.tracks import WindowTracks

__all__ = ["FittedMotion", "Motion", "WindowHypotheses", "difference_deg", "fit_hypotheses", "motions_of_pair"]

#: A further view needs this many points of the motion: twice the six unknowns of its pose in coordinates, and as many
#: again to contradict the motion.
_MIN_RESECTED = 12
#: Outlier threshold of a further view before the joint fit, in standard deviations of the noise.
_RESECTION_SIGMAS = 4.0
#: Scales of the robust kernel that aligns two views by a rotation. The first one reaches 25 degrees, the angle between
#: two photos of a panorama; the last one is a few pixels.
_ALIGNMENT_SCALES_RAD = (0.4, 0.1, 0.03, 0.01)
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
#: Largest probability of the parallax of a pair without translation, for which its motions are tried: quest speaks of a
#: translation from 1e-4 on, but further views may turn a twentieth into a certainty.
_WORTH_TRYING = 0.05
#: The window is fitted again where the noise was off by more than this factor (as a logarithm): the standard deviations
#: are off by as much. With another noise other observations are outliers, hence the rounds.
_NOISE_TOLERANCE, _NOISE_ROUNDS = 0.07, 2
#: A start whose residuals are this many times the noise is far from the answer.
_FAR_FACTOR = 1.5
#: Motions nearer than this lead to the same optimum: a third of what makes an initialization wrong.
_NEAR_ROTATION_DEG, _NEAR_DIRECTION_DEG = 1.5, 5.0
#: Two fits nearer than this are one: an order below what makes an initialization wrong.
_SAME_ROTATION_DEG, _SAME_DIRECTION_DEG = 0.3, 2.0


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of the camera through some frames.

    Attributes
    ----------
    cam_from_world : dict of int to Pose
        By absolute frame index; the world is any frame of reference.
    plane : (3,) float or None
        ``plane . X = 1`` in the world, where most points lie on one plane.
    log_scale : float
        Logarithm of the true focal length over the stated one.
    """

    cam_from_world: dict[int, Pose]
    plane: Floats | None = None
    log_scale: float = 0.0

    def is_near(self, other: Motion) -> bool:
        """Whether another motion moves the first two frames alike, so that a fit ends in the same optimum.

        Parameters
        ----------
        other : Motion

        Returns
        -------
        bool
            False where the other motion does not know these frames.
        """
        first, second = list(self.cam_from_world)[:2]
        if first not in other.cam_from_world or second not in other.cam_from_world:
            return False
        a, b = (one.cam_from_world[second] @ one.cam_from_world[first].inverse() for one in (self, other))
        rotation_deg, direction_deg = difference_deg(a, b)
        return rotation_deg <= _NEAR_ROTATION_DEG and direction_deg <= _NEAR_DIRECTION_DEG


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """A motion with the joint fit of the views that it could locate.

    Attributes
    ----------
    fit : JointFit
    rows : tuple of int
        Views of the window in the fit, reference and current first.
    frames : tuple of int
        Absolute indices of these views.
    """

    fit: JointFit
    rows: tuple[int, ...]
    frames: tuple[int, ...]

    @property
    def cam2_from_cam1(self) -> Pose:
        """The adjusted motion of the pair, with |t| = 1."""
        R, t = self.fit.state.R[1], self.fit.state.t[1]
        return Pose(R, t / max(float(np.linalg.norm(t)), 1e-300))

    @property
    def planar(self) -> bool:
        """Whether most points were held on a plane."""
        return self.fit.state.plane is not None

    @property
    def motion(self) -> Motion:
        """The adjusted motion, as the start of the next fit."""
        state = self.fit.state
        poses = {frame: Pose(state.R[k], state.t[k]) for k, frame in enumerate(self.frames)}
        return Motion(poses, state.plane, state.log_scale)

    def same_as(self, other: FittedMotion) -> bool:
        """Whether two fits ended in the same optimum.

        Parameters
        ----------
        other : FittedMotion

        Returns
        -------
        bool
        """
        rotation_deg, direction_deg = self.difference_deg(other)
        return rotation_deg <= _SAME_ROTATION_DEG and direction_deg <= _SAME_DIRECTION_DEG

    def difference_deg(self, other: FittedMotion) -> tuple[float, float]:
        """Angles between the rotations and between the directions of the pair.

        Parameters
        ----------
        other : FittedMotion

        Returns
        -------
        rotation_deg, direction_deg : float
        """
        return difference_deg(self.cam2_from_cam1, other.cam2_from_cam1)


def difference_deg(a: Pose, b: Pose) -> tuple[float, float]:
    """Angles between two rotations, and between the directions of two baselines.

    Parameters
    ----------
    a, b : Pose
        cam2_from_cam1 of the same two views.

    Returns
    -------
    rotation_deg, direction_deg : float
    """
    centre_a, centre_b = a.R.T @ a.t, b.R.T @ b.t
    lengths = max(float(np.linalg.norm(centre_a) * np.linalg.norm(centre_b)), 1e-300)
    direction = math.acos(min(max(float(centre_a @ centre_b) / lengths, -1.0), 1.0))
    return math.degrees(float(rotation_angle(a.R.T @ b.R))), math.degrees(direction)


@dataclass(frozen=True, eq=False)
class WindowHypotheses:
    """The fitted hypotheses of a window.

    Attributes
    ----------
    tracks : WindowTracks
    planar : bool
        Whether most points are held on a plane.
    motions : tuple of FittedMotion
        Different optima only, the best first: those that locate more views first, then by their cost.
    rotation_only : JointFit
        The camera that only rotates, with the focal length as an unknown.
    priors : Priors
        Of the fits.
    """

    tracks: WindowTracks
    planar: bool
    motions: tuple[FittedMotion, ...]
    rotation_only: JointFit
    priors: Priors

    @property
    def gain_over_rotation(self) -> tuple[float, float]:
        """Log likelihood of the best motion over the rotation-only camera (nats), and the degrees of freedom of it.

        Translation and points lower the cost by chance too: twice the gain has a chi-square distribution then. Tracks
        that leave the plane have paid for it.
        """
        best, seen = self.motions[0], self.tracks.seen
        missing = int(seen.sum()) - int(seen[list(best.rows)].sum())
        lowered = self.rotation_only.cost - best.fit.cost - self.priors.gate_sigmas**2 * missing
        # A distance is not negative, so that by chance half of the tracks gain nothing. But without a translation its
        # direction is chosen to suit the tracks, and outliers gain more than noise: 0.9 a track in 32 drawn windows.
        points = 3.0 if self.planar else float((self.tracks.anchor >= 0).sum())
        return 0.5 * lowered, 3 * (len(best.rows) - 1) - 1 + points

    @property
    def focal_of_rotation(self) -> tuple[float, float]:
        """The focal length of the rotation-only camera by the tracks alone, without the prior.

        Returns
        -------
        log_scale : float
            Logarithm of the focal length over the stated one; 0 where the tracks do not tell it.
        sigma : float
            Its standard deviation; infinite where the tracks do not tell it.
        """
        views = len(self.tracks.frames)
        focal = 6 * (views - 1)
        unknowns = [*(6 * k + axis for k in range(views - 1) for axis in range(3)), focal]
        information = self.rotation_only.information[np.ix_(unknowns, unknowns)]
        known = 1 / float(np.linalg.inv(information)[-1, -1])
        by_tracks = known - 1 / self.priors.focal_sigma**2
        if by_tracks <= 1e-6 * known:
            return 0.0, math.inf
        sigma = max(self.rotation_only.noise_factor, 1.0) / math.sqrt(by_tracks)
        return self.rotation_only.state.log_scale * known / by_tracks, sigma


def motions_of_pair(pose: RelativePose, frames: tuple[int, int], rays1: Floats, rays2: Floats) -> list[Motion]:
    """The motions that explain the matches of a pair.

    Parameters
    ----------
    pose : RelativePose
        ``cam2_from_cam1`` with its alternatives. If its kind is "rotation", only the alternatives have a translation.
        They are worth trying where a rotation-only camera would show as much parallax once in twenty pairs. So little
        parallax shows no relief either: the points start on a plane then.
    frames : (int, int)
        Absolute indices of reference and current.
    rays1, rays2 : (N, 3) float
        The matches that the pose was estimated from.

    Returns
    -------
    list of Motion
    """
    proposed: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    chance = pose.evidence.parallax_p
    if pose.kind == "rotation" and (chance is None or chance > _WORTH_TRYING):
        return []
    motions = []
    for one in proposed:
        if not np.any(one.t):
            continue
        plane = None
        if pose.kind != "general" and one.inliers.sum() >= _MIN_RESECTED:
            plane = plane_of_motion(one.R, one.t, rays1[one.inliers], rays2[one.inliers])
        motions.append(Motion({frames[0]: Pose.identity(), frames[1]: Pose(one.R, one.t)}, plane))
    return motions


def fit_hypotheses(
    tracks: WindowTracks, motions: Sequence[Motion], priors: Priors, least_noise_px: float = 0.1
) -> WindowHypotheses | None:
    """Fit motions, and the rotation-only camera, to all views of a window.

    Parameters
    ----------
    tracks : WindowTracks
        Views: reference, current, then further ones.
    motions : sequence of Motion
        Each knows two of the views or more. Those that know more come first: a later one that is near is left out.
    priors : Priors
    least_noise_px : float
        Lower limit of the noise, which is measured again by the residuals of the best motion.

    Returns
    -------
    WindowHypotheses or None
        None where no motion locates reference and current.
    """
    bearings = np.array([tracks.camera.bearings(pixels) for pixels in tracks.pixels])
    bearings[~tracks.seen] = np.nan
    rotations = _rotations(bearings, motions, tracks.frames[:2])
    poses: list[Motion] = []
    for motion in motions:
        if any(motion.is_near(known) for known in poses):
            continue
        located = _located(tracks, motion, bearings, rotations)
        if located is not None:
            poses.append(located)
    if not poses:
        return None
    tracks = tracks.with_noise(tracks.noise_px * _start_noise_factor(tracks, poses[0], priors))
    planar, fits = _fitted(tracks, poses, bearings, priors)
    for _ in range(_NOISE_ROUNDS):
        noise_px = max(fits[0].fit.noise_factor * tracks.noise_px, least_noise_px)
        if abs(math.log(noise_px / tracks.noise_px)) <= _NOISE_TOLERANCE:
            break
        tracks = tracks.with_noise(noise_px)
        planar, fits = _fitted(tracks, [one.motion for one in fits], bearings, priors)
    return WindowHypotheses(tracks, planar, tuple(fits), _fit_rotation(tracks, rotations, priors), priors)


def _fitted(
    tracks: WindowTracks,
    motions: Sequence[Motion],
    bearings: Floats,
    priors: Priors,
) -> tuple[bool, list[FittedMotion]]:
    """Whether the points lie on a plane, and the different optima of located motions, the best first."""
    if any(motion.plane is not None for motion in motions):
        with_plane = [_with_plane(motion, tracks, bearings) for motion in motions]
        fits = _different([_fit(tracks, motion, priors) for motion in with_plane])
        if _is_plane(tracks, fits[0], priors) and not _has_relief(tracks, fits[0], priors):
            return True, fits
    return False, _different([_fit(tracks, replace(motion, plane=None), priors) for motion in motions])


def _different(fits: list[FittedMotion]) -> list[FittedMotion]:
    """The different optima, the best first."""
    different: list[FittedMotion] = []
    for fitted in sorted(fits, key=lambda fitted: (-len(fitted.rows), fitted.fit.cost)):
        if not any(fitted.same_as(kept) for kept in different):
            different.append(fitted)
    return different


def _rotations(bearings: Floats, motions: Sequence[Motion], pair: tuple[int, ...]) -> Floats:
    """The rotations (V, 3, 3) that align view 0 best with each view; of the pair also from a proposed one."""
    R = np.tile(np.eye(3), (len(bearings), 1, 1))
    proposed = [np.eye(3)]
    for motion in motions[:1]:
        known = motion.cam_from_world
        if pair[0] in known and pair[1] in known:
            proposed.append(known[pair[1]].R @ known[pair[0]].R.T)
    for k in range(1, len(bearings)):
        both = np.isfinite(bearings[0, :, 0]) & np.isfinite(bearings[k, :, 0])
        if both.sum() >= 3:
            m, n = bearings[0, both], bearings[k, both]
            starts = proposed if k == 1 else [np.eye(3), R[1]]
            aligned = [_aligned(start, m, n) for start in starts]
            R[k] = min(aligned, key=lambda found: float(np.median(np.linalg.norm(n - m @ found.T, axis=1))))
    return R


def _aligned(R: Floats, m: Floats, n: Floats) -> Floats:
    for scale_rad in _ALIGNMENT_SCALES_RAD:
        R = refine_rotation_compiled(R, m, n, scale_rad, iterations=4)
    return R


def _fit(tracks: WindowTracks, motion: Motion, priors: Priors) -> FittedMotion:
    """Fit a motion whose frames are those of the views that it locates."""
    part, R, t, rows = _part_of(tracks, motion)
    frames = tuple(tracks.frames[row] for row in rows)
    return FittedMotion(
        fit_window(part, start_at(part, R, t, motion.plane, log_scale=motion.log_scale), priors), rows, frames
    )


def _start_noise_factor(tracks: WindowTracks, motion: Motion, priors: Priors) -> float:
    part, R, t, _ = _part_of(tracks, motion)
    return start_noise_factor(part, start_at(part, R, t, log_scale=motion.log_scale), priors)


def _part_of(tracks: WindowTracks, motion: Motion) -> tuple[WindowTracks, Floats, Floats, tuple[int, ...]]:
    """The tracks in the views of a located motion, its rotations and translations, and the rows of the views."""
    rows = tuple(row for row, frame in enumerate(tracks.frames) if frame in motion.cam_from_world)
    poses = [motion.cam_from_world[tracks.frames[row]] for row in rows]
    return tracks.of_views(rows), np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses]), rows


def _with_plane(motion: Motion, tracks: WindowTracks, bearings: Floats) -> Motion:
    """A located motion with the plane that explains most of its matches, where it has none yet."""
    if motion.plane is not None:
        return motion
    both = tracks.seen[0] & tracks.seen[1]
    pose = motion.cam_from_world[tracks.frames[1]]
    return replace(motion, plane=plane_of_motion(pose.R, pose.t, bearings[0, both], bearings[1, both]))


def _is_plane(tracks: WindowTracks, fitted: FittedMotion, priors: Priors) -> bool:
    """Whether the points of a fit lie on its plane: a relief would show, and distances of their own gain nothing."""
    on_plane = fitted.fit.state.on_plane & (tracks.anchor >= 0)
    count = int(on_plane.sum())
    if count < max(_LEAST_TRACKS_ON_PLANE, _LEAST_ON_PLANE * float((tracks.anchor >= 0).sum())):
        return False
    part = tracks.of_views(fitted.rows)
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
    free = _fit(tracks, replace(fitted.motion, plane=None), priors)
    gain = fitted.fit.cost - OFF_PLANE_COST * left - free.fit.cost
    return not _is_chance(gain / max(free.fit.noise_factor, 1.0) ** 2, count, _RELIEF_SIGMAS)


def _is_chance(gain: float, count: int, sigmas: float) -> bool:
    """Whether chance lowers the cost by as much where this number of tracks gets a distance each."""
    return gain <= count + sigmas * math.sqrt(2 * count)


def _located(tracks: WindowTracks, motion: Motion, bearings: Floats, rotations: Floats) -> Motion | None:
    """A motion with all views that it knows or that its points locate; its world is the reference.

    None where reference or current is not among them.
    """
    known = _resected(tracks, motion, bearings, rotations)
    if 0 not in known or 1 not in known:
        return None
    to_reference = known[0].inverse()
    plane = None if motion.plane is None else _moved_plane(motion.plane, known[0])
    return Motion({tracks.frames[row]: known[row] @ to_reference for row in sorted(known)}, plane, motion.log_scale)


def _resected(tracks: WindowTracks, motion: Motion, bearings: Floats, rotations: Floats) -> dict[int, Pose]:
    """The poses of the views that a motion knows or that its points locate, by row."""
    frames = enumerate(tracks.frames)
    known = {row: motion.cam_from_world[frame] for row, frame in frames if frame in motion.cam_from_world}
    if len(known) < 2 or len(known) == len(tracks.frames):
        return known
    threshold_rad = _RESECTION_SIGMAS * tracks.noise_px / tracks.camera.focal_px
    rows = list(known)
    points = triangulate([pose.inverse() for pose in known.values()], bearings[rows])
    usable = _explained(points, list(known.values()), bearings[rows], threshold_rad)
    for row in range(len(bearings)):
        visible = usable & np.isfinite(bearings[row, :, 0])
        if row in known or visible.sum() < _MIN_RESECTED:
            continue
        nearest = min(rows, key=lambda one: abs(tracks.frames[one] - tracks.frames[row]))
        turned = Pose(rotations[row] @ rotations[nearest].T, np.zeros(3)) @ known[nearest]
        resected = resect(points[visible], bearings[row, visible], threshold_rad, turned)
        if resected is not None and resected[1].sum() >= _MIN_RESECTED:
            known[row] = resected[0]
    return known


def _explained(points: Floats, poses: list[Pose], bearings: Floats, threshold_rad: float) -> Bools:
    """The points that lie in front of the known cameras and project to their tracks in at least two of them."""
    finite = np.isfinite(points).all(axis=1)
    filled = np.nan_to_num(points)
    agreeing = np.zeros(len(points), int)
    against = np.zeros(len(points), int)
    for pose, rays in zip(poses, bearings, strict=True):
        local = pose.apply(filled)
        local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-300)
        seen = np.isfinite(rays[:, 0])
        near = np.linalg.norm(local - np.nan_to_num(rays), axis=1) < threshold_rad
        agreeing += seen & near
        against += seen & ~near
    return np.asarray(finite & (agreeing >= 2) & (against <= agreeing // 2))


def _moved_plane(plane: Floats, new_from_old: Pose) -> Floats:
    """A plane ``k . X = 1`` in another frame of reference."""
    turned = new_from_old.R @ plane
    return np.asarray(turned / (1 + float(turned @ new_from_old.t)))


def _fit_rotation(tracks: WindowTracks, rotations: Floats, priors: Priors) -> JointFit:
    # The translation has no effect on points at infinity; its length only has to differ from zero.
    t = np.outer(np.arange(len(rotations)), [1e-9, 0.0, 0.0])
    start = start_at(tracks, rotations, t, at_infinity=True)
    # A wrong focal length moves the tracks by many times their noise, so the fit starts with a noise that allows it.
    factor = start_noise_factor(tracks, start, priors, rotation_only=True)
    for wider in (factor, math.sqrt(factor)) if factor > _FAR_FACTOR else ():
        wide = tracks.with_noise(wider * tracks.noise_px)
        start = fit_window(wide, start, priors, rotation_only=True).state
    return fit_window(tracks, start, priors, rotation_only=True)
