"""How far an estimated trajectory is from the truth.

A monocular map has no scale and no preferred frame, so positions are compared after the similarity that
brings them closest: ``truth_i ~ s R estimated_i + t`` ([Umeyama 1991]_, eqs. 34 to 43). The figures agree
with evo's.

Degenerate alignments are answered, not refused, because initial maps are short. On collinear positions (two
keyframes always are) the rotation about their line is free; the residual does not depend on it, hence neither
does the ATE. Two positions are fitted exactly: their ATE is 0 and says nothing. :func:`align_poses` uses the
orientations too and has no such freedom.

References
----------
.. [Umeyama 1991] S. Umeyama, Least-squares estimation of transformation parameters between two point
   patterns, IEEE TPAMI 13(4), 1991.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quest.geometry.quaternion import rotation_angle
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose, Trajectory

__all__ = [
    "Similarity",
    "align_poses",
    "align_positions",
    "ate_rmse",
    "compare_with_groundtruth",
    "relative_pose_errors",
]

#: Baselines shorter than this share of the longest say little about direction: noise turns them.
_SHORT_BASELINE = 0.3
#: A path shorter than this (in ground-truth units, in practice metres) is a camera on a stand: the
#: measurements of no motion capture resolve it, so it has neither direction nor scale.
_STATIC_PATH = 1e-6


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale R x + t`` between two worlds."""

    scale: float
    R: Floats
    t: Floats

    def apply(self, points: Floats) -> Floats:
        """Transform points (..., 3)."""
        return self.scale * points @ self.R.T + self.t


def align_positions(source: Floats, target: Floats) -> Similarity:
    """The similarity that brings positions closest to others in the least-squares sense.

    Parameters
    ----------
    source, target : (N, 3) float
        Corresponding positions, N >= 1.

    Returns
    -------
    Similarity
        ``target ~ scale R source + t``. Scale 1 where the source positions coincide, 0 where only the
        target's do; an arbitrary one of the equally good rotations where the positions are collinear.

    Raises
    ------
    ValueError
        Where the shapes differ or nothing is given.
    """
    source, target = np.asarray(source, float), np.asarray(target, float)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) == 0:
        raise ValueError(f"positions of shapes {source.shape} and {target.shape}: both must be (N, 3), N >= 1")
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    U, singular, Vt = np.linalg.svd(b.T @ a / len(a))
    signs = np.array([1.0, 1.0, 1.0 if np.linalg.det(U) * np.linalg.det(Vt) > 0 else -1.0])
    R = (U * signs) @ Vt
    variance = float(np.mean(np.sum(a * a, axis=1)))
    scale = float(singular @ signs) / variance if variance > 0 else 1.0
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def align_poses(source: Sequence[Pose], target: Sequence[Pose]) -> Similarity:
    """The similarity between two worlds that have the same cameras in them, orientations included.

    The rotation is the chordal mean of ``target_i.R source_i.R^T``, so that it is unique from the first
    camera on, collinear or not; the scale is the ratio of the spreads of the centres.

    Parameters
    ----------
    source, target : sequences of N Pose
        Corresponding ``world_from_cam``, N >= 1.

    Returns
    -------
    Similarity
        From the source's world to the target's. Scale 1 where either stands still.
    """
    total = np.sum([b.R @ a.R.T for a, b in zip(source, target, strict=True)], axis=0)
    U, _, Vt = np.linalg.svd(total)
    R = (U * [1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    a, b = np.array([pose.t for pose in source]), np.array([pose.t for pose in target])
    spread_a, spread_b = np.linalg.norm(a - a.mean(axis=0)), np.linalg.norm(b - b.mean(axis=0))
    scale = float(spread_b / spread_a) if spread_a > 0 and spread_b > 0 else 1.0
    return Similarity(scale, R, b.mean(axis=0) - scale * R @ a.mean(axis=0))


def ate_rmse(estimated: Floats, truth: Floats) -> float:
    """Absolute trajectory error after alignment by a similarity.

    Parameters
    ----------
    estimated, truth : (N, 3) float
        Corresponding positions, N >= 1. For N <= 2 the error is 0 by construction.

    Returns
    -------
    float
        Root mean square distance in units of the truth.

    Raises
    ------
    ValueError
        Where the shapes differ or nothing is given.
    """
    residuals = truth - align_positions(estimated, truth).apply(estimated)
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def relative_pose_errors(estimated: Sequence[Pose], truth: Sequence[Pose], delta: int = 1) -> tuple[Floats, Floats]:
    """Relative pose errors (RPE) over steps of ``delta`` poses, all pairs.

    Nothing is aligned: bring the estimate to the truth's scale first (:func:`align_positions`).

    Parameters
    ----------
    estimated, truth : sequences of N Pose
        Corresponding ``world_from_cam``.
    delta : int
        Number of poses in a step.

    Returns
    -------
    translation : (N - delta,) float
        Distance between the estimated and the true relative translation, in units of the trajectories.
    rotation_deg : (N - delta,) float
    """
    steps = range(len(truth) - delta)
    errors = [
        (truth[i].inverse() @ truth[i + delta]).inverse() @ (estimated[i].inverse() @ estimated[i + delta])
        for i in steps
    ]
    translation = np.array([np.linalg.norm(error.t) for error in errors])
    rotation_deg = np.array([np.rad2deg(rotation_angle(error.R)) for error in errors])
    return translation, rotation_deg


def compare_with_groundtruth(
    keyframes: Sequence[Keyframe], trajectory: Trajectory | None, tolerance_s: float = 0.02
) -> dict[str, float | None] | None:
    """The figures of the summary's ``ground_truth``.

    Parameters
    ----------
    keyframes : sequence of Keyframe
        In time order.
    trajectory : Trajectory or None
        The truth. Keyframes without a true pose within the tolerance are left out.
    tolerance_s : float
        Largest difference of time stamps in seconds.

    Returns
    -------
    dict or None
        None where fewer than two keyframes have a true pose. Else

        ``rotation_error_deg``
            Worst keyframe against the first: angle between estimated and true relative rotation.
        ``direction_error_deg``
            Worst keyframe against the first: angle between estimated and true relative translation, in the
            first camera's frame; true baselines under 0.3 of the longest are left out. A keyframe estimated
            exactly at the first one has no direction and counts as 180. None where the truth stands still.
        ``ate_rmse``
            Of the keyframes, in ground-truth units (:func:`ate_rmse`; 0 for two). None where the truth
            stands still.
        ``path_length``
            Of the ground truth from the first keyframe to the last, in its units.
    """
    if trajectory is None:
        return None
    pairs = [(k, truth) for k in keyframes if (truth := trajectory.at(k.timestamp_s, tolerance_s)) is not None]
    if len(pairs) < 2:
        return None
    (first, first_truth), rest = pairs[0], pairs[1:]
    estimated = [first.world_from_cam.inverse() @ k.world_from_cam for k, _ in rest]
    true = [first_truth.inverse() @ truth for _, truth in rest]
    rotations_deg = [np.rad2deg(rotation_angle(a.R @ b.R.T)) for a, b in zip(estimated, true, strict=True)]
    result: dict[str, float | None] = {
        "rotation_error_deg": float(max(rotations_deg)),
        "direction_error_deg": None,
        "ate_rmse": None,
        "path_length": _path_length(trajectory, first.timestamp_s, pairs[-1][0].timestamp_s),
    }
    baselines = [float(np.linalg.norm(pose.t)) for pose in true]
    longest = max(baselines)
    if longest > _STATIC_PATH:
        result["direction_error_deg"] = max(
            _angle_deg(a.t, b.t)
            for a, b, baseline in zip(estimated, true, baselines, strict=True)
            if baseline >= _SHORT_BASELINE * longest
        )
        result["ate_rmse"] = ate_rmse(
            np.array([k.world_from_cam.t for k, _ in pairs]), np.array([truth.t for _, truth in pairs])
        )
    return result


def _path_length(trajectory: Trajectory, first_s: float, last_s: float) -> float:
    """Length of the trajectory between the poses nearest to two times."""
    i, j = (int(np.argmin(np.abs(trajectory.timestamps_s - t))) for t in (first_s, last_s))
    positions = np.array([pose.t for pose in trajectory.world_from_cam[i : j + 1]])
    return float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))


def _angle_deg(a: Floats, b: Floats) -> float:
    """Angle between two vectors; 180 where the first has no direction."""
    if not np.any(a):
        return 180.0
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
