"""The hypotheses of a window, each with one joint fit of all its views: the motions of a pair, a rotation-only camera.

quest proposes the motions from the pair. Each motion is carried to all views: the points of the pair locate the further
views, then everything is fitted jointly. The points of a planar pair lie on one plane; tracks off the plane count as
outliers then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, RelativePose
from quest.geometry.quaternion import rotation_angle
from quest.robust.rotation import refine_rotation_compiled
from slam_init.mapping.plane import plane_of_motion
from slam_init.mapping.triangulation import resect, triangulate
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose
from slam_init.window.joint_fit import JointFit, Priors, fit_window, start_at, with_error_fields
from slam_init.window.tracks import WindowTracks

__all__ = ["FittedMotion", "WindowHypotheses", "fit_hypotheses"]

#: A further view needs this many points of the pair: twice the six unknowns of its pose in coordinates, and as many
#: again to contradict the pair.
_MIN_RESECTED = 12
#: Outlier threshold of a further view before the joint fit, in standard deviations of the noise.
_RESECTION_SIGMAS = 4.0
#: Scales of the robust kernel that aligns two views by a rotation. The first one reaches 25 degrees, the angle between
#: two photos of a panorama; the last one is a few pixels.
_ALIGNMENT_SCALES_RAD = (0.4, 0.1, 0.03, 0.01)
#: Two fits nearer than this are one: an order below what makes an initialization wrong.
_SAME_ROTATION_DEG, _SAME_DIRECTION_DEG = 0.3, 2.0


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """A motion of the pair with the joint fit of the views that it could locate.

    Attributes
    ----------
    motion : Hypothesis or RelativePose
        As quest proposed it.
    fit : JointFit
    rows : tuple of int
        Views of the window in the fit, reference and current first.
    """

    motion: Hypothesis | RelativePose
    fit: JointFit
    rows: tuple[int, ...]

    @property
    def cam2_from_cam1(self) -> Pose:
        """The adjusted motion of the pair, with |t| = 1."""
        R, t = self.fit.state.R[1], self.fit.state.t[1]
        return Pose(R, t / max(float(np.linalg.norm(t)), 1e-300))

    def same_as(self, other: FittedMotion) -> bool:
        """Whether two fits ended in the same optimum.

        Parameters
        ----------
        other : FittedMotion

        Returns
        -------
        bool
        """
        a, b = self.cam2_from_cam1, other.cam2_from_cam1
        direction = np.degrees(np.arccos(np.clip(float((a.R.T @ a.t) @ (b.R.T @ b.t)), -1, 1)))
        rotation = np.degrees(float(rotation_angle(a.R.T @ b.R)))
        return bool(rotation <= _SAME_ROTATION_DEG and direction <= _SAME_DIRECTION_DEG)


@dataclass(frozen=True, eq=False)
class WindowHypotheses:
    """The fitted hypotheses of a window.

    Attributes
    ----------
    tracks : WindowTracks
    planar : bool
        Whether the points were held on a plane.
    motions : tuple of FittedMotion
        Different optima only, the best first: those that locate more views first, then by their cost. The
        information of the best one allows for error fields.
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


def fit_hypotheses(
    tracks: WindowTracks, pose: RelativePose, rays1: Floats, rays2: Floats, priors: Priors
) -> WindowHypotheses:
    """Fit every motion of a pair, and the rotation-only camera, to all views of a window.

    Parameters
    ----------
    tracks : WindowTracks
        Views: reference, current, then further ones.
    pose : RelativePose
        ``cam2_from_cam1`` of reference and current, with its alternatives; not of kind "rotation".
    rays1, rays2 : (N, 3) float
        The matches that the pose was estimated from.
    priors : Priors

    Returns
    -------
    WindowHypotheses
    """
    bearings = np.array([tracks.camera.bearings(pixels) for pixels in tracks.pixels])
    bearings[~tracks.seen] = np.nan
    rotations = _rotations(bearings, pose.R)
    planar = pose.kind == "planar"
    fits = []
    motions: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
    for motion in motions:
        plane = None
        if planar:
            plane = plane_of_motion(motion.R, motion.t, rays1[motion.inliers], rays2[motion.inliers])
        fits.append(_fit_motion(tracks, motion, plane, bearings, rotations, priors))
    fits.sort(key=lambda fitted: (-len(fitted.rows), fitted.fit.cost))
    different: list[FittedMotion] = []
    for fitted in fits:
        if not any(fitted.same_as(kept) for kept in different):
            different.append(fitted)
    best = different[0]
    different[0] = replace(best, fit=with_error_fields(tracks.of_views(best.rows), best.fit, priors))
    return WindowHypotheses(tracks, planar, tuple(different), _fit_rotation(tracks, rotations, priors), priors)


def _rotations(bearings: Floats, proposed: Floats) -> Floats:
    """The rotations (V, 3, 3) that align view 0 best with each view; of the pair also from a proposed one."""
    R = np.tile(np.eye(3), (len(bearings), 1, 1))
    for k in range(1, len(bearings)):
        both = np.isfinite(bearings[0, :, 0]) & np.isfinite(bearings[k, :, 0])
        if both.sum() >= 3:
            m, n = bearings[0, both], bearings[k, both]
            starts = [np.eye(3), proposed] if k == 1 else [np.eye(3), R[1]]
            aligned = [_aligned(start, m, n) for start in starts]
            R[k] = min(aligned, key=lambda found: float(np.median(np.linalg.norm(n - m @ found.T, axis=1))))
    return R


def _aligned(R: Floats, m: Floats, n: Floats) -> Floats:
    for scale_rad in _ALIGNMENT_SCALES_RAD:
        R = refine_rotation_compiled(R, m, n, scale_rad, iterations=4)
    return R


def _fit_motion(
    tracks: WindowTracks,
    motion: Hypothesis | RelativePose,
    plane: Floats | None,
    bearings: Floats,
    rotations: Floats,
    priors: Priors,
) -> FittedMotion:
    threshold_rad = _RESECTION_SIGMAS * float(np.median(tracks.sigma_px)) / tracks.camera.focal_px
    poses = {0: Pose.identity(), 1: Pose(motion.R, motion.t)}  # row -> cam_from_world
    points = triangulate([poses[0], poses[1].inverse()], bearings[:2])
    usable = _explained(points, motion, bearings, threshold_rad)
    for k in range(2, len(bearings)):
        visible = usable & np.isfinite(bearings[k, :, 0])
        if visible.sum() < _MIN_RESECTED:
            continue
        guess = Pose(rotations[k], np.zeros(3))
        resected = resect(points[visible], bearings[k, visible], threshold_rad, guess)
        if resected is not None and resected[1].sum() >= _MIN_RESECTED:
            poses[k] = resected[0]
    rows = tuple(poses)
    R, t = np.array([pose.R for pose in poses.values()]), np.array([pose.t for pose in poses.values()])
    part = tracks.of_views(rows)
    return FittedMotion(
        motion, fit_window(part, start_at(part, R, t, plane), replace(priors, field_sigma_px=0.0)), rows
    )


def _explained(points: Floats, motion: Hypothesis | RelativePose, bearings: Floats, threshold_rad: float) -> Bools:
    """The points of the pair that lie in front of both cameras and project to their matches."""
    found = np.isfinite(points).all(axis=1)
    found &= np.einsum("ij,ij->i", np.nan_to_num(points), np.nan_to_num(bearings[0])) > 0
    second = np.nan_to_num(points) @ motion.R.T + motion.t
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), 1e-300)
    found &= np.linalg.norm(second - np.nan_to_num(bearings[1]), axis=1) < threshold_rad
    return np.asarray(found)


def _fit_rotation(tracks: WindowTracks, rotations: Floats, priors: Priors) -> JointFit:
    # The translation has no effect on points at infinity; its length only has to differ from zero.
    t = np.outer(np.arange(len(rotations)), [1e-9, 0.0, 0.0])
    start = start_at(tracks, rotations, t, at_infinity=True)
    return fit_window(tracks, start, replace(priors, field_sigma_px=0.0), rotation_only=True)
