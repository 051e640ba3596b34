"""Errors of an estimated trajectory against the ground truth.

A monocular map has no scale and no preferred frame. Positions are therefore compared after alignment by the
least-squares similarity ``truth_i ~ s R estimated_i + t`` ([Umeyama 1991]_, eqs. 34 to 43). The figures are equal to
those of the package evo.

Degenerate alignments give a result instead of an error, because initial maps are short. If the positions are collinear
(two positions always are), the rotation about their line is not determined. The residuals do not depend on this
rotation, so the ATE does not depend on it either. Two positions are fitted exactly: their ATE is always 0 and carries
no information. :func:`align_poses` also uses the orientations, so its rotation is always determined.

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
from slam_init.types.result import GroundTruthErrors

#: The direction of a baseline shorter than this share of the longest baseline is not compared: noise dominates it.
_SHORT_BASELINE = 0.3
#: A path shorter than this (in ground-truth units, usually metres) is that of a static camera. No motion capture
#: resolves such a length, so the path has neither a direction nor a scale.
_STATIC_PATH = 1e-6
#: Largest difference between the time stamps of a keyframe and of its true pose.
_SAME_TIME_S = 0.02
#: Accuracy of measured positions. The makers of TUM RGB-D state 1 cm for their motion capture (Sturm et al. 2012).
#: Depth tracking, such as KinectFusion in 7-Scenes, is no better. Their noise from pose to pose is .1 to .9 mm.
#: Class: assumption, in metres.
_MEASURED_M = 0.01
#: Noise over the median step beyond which positions are measured. It is .03 to .12 in TUM RGB-D, 7-Scenes and poses of
#: a checkerboard, and below .001 in rendered sequences and for the GPS and gyroscopes of KITTI.
#: Class: measured.
_NOISY = 0.01
#: Poses further apart in time are those of photographs: their steps differ by the motion, and not by noise.
#: Class: assumption, in seconds.
_SLOWEST_S = 0.2
#: Fewer poses do not determine the noise.
#: Class: level.
_FEWEST = 8
#: Median length of the third differences of positions whose coordinates have a noise of 1: the variance is 20, and the
#: median of chi-square with three degrees of freedom 2.37.
#: Class: geometry.
_THIRD_DIFFERENCE = float(np.sqrt(20 * 2.37))


@dataclass(frozen=True, eq=False)
class Similarity:
    """The transformation ``x -> scale R x + t`` between two worlds."""

    scale: float
    #: (3, 3) Rotation matrix.
    R: Floats
    #: (3,)
    t: Floats

    def apply(self, points: Floats) -> Floats:
        """Transform points.

        Shapes: ``points`` (..., 3), returns (..., 3).
        """
        return self.scale * points @ self.R.T + self.t


def align_positions(source: Floats, target: Floats) -> Similarity:
    """Compute the least-squares similarity between two sets of positions.

    Shapes: ``source, target`` (N, 3), N >= 1, all finite.

    * Returns: ``target ~ scale R source + t``. The scale is 1 if all source positions coincide, and 0 if only the
      target positions coincide. If the positions are collinear, the rotation is one of the equally good ones.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    U, singular, Vt = np.linalg.svd(b.T @ a / len(a))
    signs = np.array([1.0, 1.0, 1.0 if np.linalg.det(U) * np.linalg.det(Vt) > 0 else -1.0])
    R = (U * signs) @ Vt
    variance = float(np.mean(np.sum(a * a, axis=1)))
    scale = float(singular @ signs) / variance if variance > 0 else 1.0
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def align_poses(source: Sequence[Pose], target: Sequence[Pose]) -> Similarity:
    """Compute the similarity between two worlds from the poses of the same cameras in both.

    The rotation is the chordal mean of ``target_i.R source_i.R^T``. It is unique for any number of cameras, also if
    their centres are collinear. The scale is the ratio of the spreads of the centres.

    * Returns: From the source world to the target world. The scale is 1 if all cameras of one world coincide.
    """
    total = np.sum([b.R @ a.R.T for a, b in zip(source, target, strict=True)], axis=0)
    U, _, Vt = np.linalg.svd(total)
    R = (U * [1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    a, b = np.array([pose.t for pose in source]), np.array([pose.t for pose in target])
    spread_a, spread_b = np.linalg.norm(a - a.mean(axis=0)), np.linalg.norm(b - b.mean(axis=0))
    scale = float(spread_b / spread_a) if spread_a > 0 and spread_b > 0 else 1.0
    return Similarity(scale, R, b.mean(axis=0) - scale * R @ a.mean(axis=0))


def with_true_poses(keyframes: Sequence[Keyframe], truth: Trajectory) -> list[tuple[Keyframe, Pose]]:
    """Pair keyframes with their true poses; those without one within 0.02 s are left out."""
    return [(k, true) for k in keyframes if (true := truth.at(k.timestamp_s, _SAME_TIME_S)) is not None]


def positions_of(pairs: Sequence[tuple[Keyframe, Pose]]) -> tuple[Floats, Floats]:
    """Return the estimated and the true positions (N, 3) of keyframes."""
    return np.array([keyframe.world_from_cam.t for keyframe, _ in pairs]), np.array([true.t for _, true in pairs])


def align_truth(keyframes: Sequence[Keyframe], truth: Trajectory) -> Similarity | None:
    """Compute the similarity from the world of the ground truth to that of the keyframes.

    * Returns: None if fewer than two keyframes have a true pose.
    """
    pairs = with_true_poses(keyframes, truth)
    if len(pairs) < 2:
        return None
    return align_poses([true for _, true in pairs], [keyframe.world_from_cam for keyframe, _ in pairs])


def positions_between(trajectory: Trajectory, first_s: float, last_s: float) -> Floats:
    """Return the positions (N, 3) from the pose that is nearest to one time to that nearest to another."""
    first, last = (int(np.argmin(np.abs(trajectory.timestamps_s - t))) for t in (first_s, last_s))
    return np.array([pose.t for pose in trajectory.world_from_cam[first : last + 1]]).reshape(-1, 3)


def true_path(keyframes: Sequence[Keyframe], truth: Trajectory | None) -> Floats:
    """Return the true positions (N, 3) from the first keyframe to the last one, in the frame of the map.

    * Returns: Empty if there is no ground truth, or if it cannot be aligned.
    """
    if truth is not None and (world_from_gt := align_truth(keyframes, truth)) is not None:
        return world_from_gt.apply(positions_between(truth, keyframes[0].timestamp_s, keyframes[-1].timestamp_s))
    return np.zeros((0, 3))


def ate_rmse(estimated: Floats, truth: Floats) -> float:
    """Compute the absolute trajectory error (ATE) after alignment by a similarity.

    Shapes: ``estimated, truth`` (N, 3).

    * ``estimated, truth``: Corresponding positions, N >= 1. For N <= 2 the error is 0 by construction.
    """
    residuals = truth - align_positions(estimated, truth).apply(estimated)
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def compare_with_groundtruth(keyframes: Sequence[Keyframe], trajectory: Trajectory | None) -> GroundTruthErrors | None:
    """Compute the errors of keyframes against the true trajectory: ``ground_truth`` in ``summary.json``.

    * ``trajectory``: The true trajectory. Keyframes without a true pose within 0.02 s are left out.
    * Returns: None if fewer than two keyframes have a true pose. The direction and the ATE are None if the true camera
      is static.
    """
    if trajectory is None:
        return None
    pairs = with_true_poses(keyframes, trajectory)
    if len(pairs) < 2:
        return None
    (first, first_truth), rest = pairs[0], pairs[1:]
    estimated = [first.world_from_cam.inverse() @ k.world_from_cam for k, _ in rest]
    true = [first_truth.inverse() @ truth for _, truth in rest]
    rotations_deg = [np.rad2deg(rotation_angle(a.R @ b.R.T)) for a, b in zip(estimated, true, strict=True)]
    direction_error_deg = true_direction_sigma_deg = true_baseline = ate = None
    baselines = [float(np.linalg.norm(pose.t)) for pose in true]
    longest = max(baselines)
    if longest > _STATIC_PATH:
        direction_error_deg, true_baseline = max(
            (_angle_deg(a.t, b.t), baseline)
            for a, b, baseline in zip(estimated, true, baselines, strict=True)
            if baseline >= _SHORT_BASELINE * longest
        )
        true_direction_sigma_deg = float(np.rad2deg(np.arctan2(_position_sigma_m(trajectory), true_baseline)))
        ate = ate_rmse(*positions_of(pairs)) if len(pairs) > 2 else None
    path = positions_between(trajectory, first.timestamp_s, pairs[-1][0].timestamp_s)
    return GroundTruthErrors(
        rotation_error_deg=float(max(rotations_deg)),
        direction_error_deg=direction_error_deg,
        ate_rmse=ate,
        path_length=float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1))),
        true_direction_sigma_deg=true_direction_sigma_deg,
        true_baseline=true_baseline,
    )


def scale_error(keyframes: Sequence[Keyframe], trajectory: Trajectory) -> float | None:
    """Compare the lengths of a map in metres with the true ones.

    * Returns: Lengths of the map over the true ones, minus 1, by the similarity between the positions. None if fewer
      than two keyframes have a true pose, or one of the cameras does not move.
    """
    pairs = with_true_poses(keyframes, trajectory)
    if len(pairs) < 2:
        return None
    estimated, true = positions_of(pairs)
    if not (np.ptp(estimated, axis=0).any() and np.ptp(true, axis=0).max() > _STATIC_PATH):
        return None
    return 1 / align_positions(estimated, true).scale - 1


def _angle_deg(a: Floats, b: Floats) -> float:
    """Return the angle between two vectors; 180 if the first one is zero."""
    if not np.any(a):
        return 180.0
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _position_sigma_m(truth: Trajectory) -> float:
    """Standard deviation of the true positions; 0 where nothing states that they are measured.

    A rendered trajectory is smooth to the last digits. A measured one is noisy from pose to pose. This noise is a small
    part of its error: the clocks, the calibration of the camera and a rolling shutter add errors that change slowly.
    """
    positions = np.array([pose.t for pose in truth.world_from_cam])
    if len(positions) < _FEWEST or np.median(np.diff(truth.timestamps_s)) > _SLOWEST_S:
        return 0.0
    step, third = (float(np.median(np.linalg.norm(np.diff(positions, n, axis=0), axis=1))) for n in (1, 3))
    return _MEASURED_M if third / _THIRD_DIFFERENCE > _NOISY * step else 0.0
