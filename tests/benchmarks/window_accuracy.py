"""True errors of a fitted window, beside the covariance that the fit states."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from quest.geometry.quaternion import quaternion_from_matrix, rotation_angle
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.motion import FittedMotion
from slam_init.window.risk import WindowRisk
from slam_init.window.uncertainty import (
    ExpandedFit,
    direction_uncertainty,
    expand,
    inverse_distances,
    rotation_covariance,
)
from tests.benchmarks.window_log import Accuracy

#: A shorter baseline is none; in the units of the truth.
_NO_BASELINE = 1e-9
#: Half-width of the two-sided 95 % interval of a Gaussian, in standard deviations.
_Z95 = 1.96


@dataclass(frozen=True, eq=False)
class WindowTruth:
    """The truth of the frames of a window."""

    #: By absolute frame index.
    cam_from_world: Mapping[int, Pose]
    #: (M, 3) Points in the world by track id; NaN for outliers and for points that move. None if they are not known.
    points: Floats | None = None
    #: The camera does not translate, so that no direction is right.
    no_translation: bool = False


def accuracy_of(hypotheses: WindowHypotheses, risk: WindowRisk, truth: WindowTruth) -> Accuracy:
    """Judge the best hypothesis of a window."""
    best = hypotheses.motions[0]
    to_reference = truth.cam_from_world[best.frames[0]].inverse()
    true = [truth.cam_from_world[frame] @ to_reference for frame in best.frames]
    with single_threaded():
        expanded = expand(hypotheses, best)
        # The true rotation is that of this vector after the fitted one.
        turn = _rotation_vector(true[1].R @ best.fit.state.R[1].T)
        direction_deg, direction_nees, scattered = _direction(expanded, risk, true[1], truth.no_translation)
        tracks, covered, depth_nees, depth_median_nees = _depths(expanded, true[1], truth)
        return Accuracy(
            rotation_deg=_largest_rotation_deg(best, true),
            direction_deg=direction_deg,
            rotation_nees=_nees(turn, rotation_covariance(expanded)),
            direction_nees=direction_nees,
            scattered_direction_nees=scattered,
            depth_tracks=tracks,
            depth_covered=covered,
            depth_nees=depth_nees,
            depth_median_nees=depth_median_nees,
        )


def _largest_rotation_deg(motion: FittedMotion, true: list[Pose]) -> float:
    return max(
        math.degrees(float(rotation_angle(R.T @ pose.R))) for R, pose in zip(motion.fit.state.R, true, strict=True)
    )


def _direction(expanded: ExpandedFit, risk: WindowRisk, true: Pose, no_translation: bool) -> tuple[float, float, float]:
    """Error in degrees, and its normalized square by the expansion and with the scatter of the scores."""
    length = float(np.linalg.norm(true.t))
    if no_translation or length < _NO_BASELINE:
        return 180.0, math.nan, math.nan
    found, towards = expanded.fit.state.R[1].T @ expanded.fit.state.t[1], true.R.T @ true.t / length
    found = found / max(float(np.linalg.norm(found)), 1e-300)
    angle = math.atan2(float(np.linalg.norm(np.cross(found, towards))), float(found @ towards))
    stated = direction_uncertainty(expanded)
    across = stated.basis @ towards
    error = angle * across / max(float(np.linalg.norm(across)), 1e-300)
    nees = _nees(error, stated.covariance)
    largest_deg = math.degrees(math.sqrt(float(np.linalg.eigvalsh(stated.covariance)[-1])))
    return math.degrees(angle), nees, nees * (largest_deg / max(risk.direction_sigma_deg, 1e-300)) ** 2


def _depths(expanded: ExpandedFit, true: Pose, truth: WindowTruth) -> tuple[int, int, float, float]:
    """Tracks whose distance is judged, those within 95 %, and the mean and the median of their normalized squares."""
    length = float(np.linalg.norm(true.t))
    if truth.points is None or truth.no_translation or length < _NO_BASELINE:
        return 0, 0, math.nan, math.nan
    reference = truth.cam_from_world[expanded.tracks.frames[0]]
    points = truth.points[expanded.tracks.track_ids]
    stated = inverse_distances(expanded)
    judged = stated.known & np.isfinite(points).all(axis=1)
    if not judged.any():
        return 0, 0, math.nan, math.nan
    expected = length / np.linalg.norm(points[judged] - reference.centre, axis=1)
    squares = ((stated.values[judged] - expected) / np.maximum(stated.sigmas[judged], 1e-300)) ** 2
    return int(judged.sum()), int((squares <= _Z95**2).sum()), float(squares.mean()), float(np.median(squares))


def _rotation_vector(R: Floats) -> Floats:
    q = quaternion_from_matrix(R)
    sine = float(np.linalg.norm(q[1:]))
    return np.asarray(q[1:] * (2 * math.atan2(sine, float(q[0])) / max(sine, 1e-300)))


def _nees(error: Floats, covariance: Floats) -> float:
    return float(error @ np.linalg.solve(covariance, error))
