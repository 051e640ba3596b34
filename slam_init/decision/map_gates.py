"""Whether a map is good enough to be handed over: gates, each with its value, its threshold and its reason."""

from __future__ import annotations

import numpy as np

from quest.geometry.refine import refine_pose
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.bundle.problem import BundleSolution
from slam_init.config import AcceptanceConfig
from slam_init.mapping.candidate import MapCandidate
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose
from slam_init.types.reasons import ACCEPTED, ADVICE, Gate

__all__ = ["check", "depth_sigma", "direction_bound_deg", "direction_focal_deg", "direction_sigmas_deg"]

#: Views nearer to the first than this share of the longest baseline have no direction worth a statement.
_SHORT_BASELINE = 0.3


def check(
    camera: Camera,
    candidate: MapCandidate,
    bundle: BundleSolution,
    shared_turn_rad: float,
    near_deg: float,
    config: AcceptanceConfig,
) -> tuple[str, list[Gate]]:
    """The verdict on an adjusted map, and all gates.

    Parameters
    ----------
    camera : Camera
    candidate : MapCandidate
    bundle : BundleSolution
        The adjusted map of the candidate.
    shared_turn_rad : float
        By how much errors that tracks share may turn the baseline of the pair (:mod:`slam_init.decision.correlated_error`).
    near_deg : float
        How far the baselines of a nearly equal map are that could not be ruled out.
    config : AcceptanceConfig
    """
    points = len(bundle.problem.points)
    error = config.max_direction_error_deg
    explained = points / max(len(candidate.table.track_ids), 1)
    sideways = "translate sideways: the path is too short for the depth of the scene"
    gates = [
        Gate(
            "direction_bound_deg",
            direction_bound_deg(candidate, bundle, shared_turn_rad) + near_deg,
            error,
            False,
            "low_parallax",
            sideways,
        ),
        Gate(
            "direction_focal_deg",
            direction_focal_deg(camera, candidate, bundle, config.focal_error),
            error,
            False,
            "low_parallax",
            "the direction of motion hangs on the exact focal length: translate further for the same turn",
        ),
        Gate(
            "direction_shift_deg",
            direction_shift_deg(candidate, bundle),
            error,
            False,
            "low_parallax",
            "two views and all views disagree on the direction of motion: translate further, best sideways",
        ),
        Gate(
            "depth_sigma",
            depth_sigma(camera, bundle),
            config.max_median_depth_sigma,
            False,
            "low_parallax",
            "translate sideways, or come nearer: the depths are too uncertain",
        ),
        Gate("landmarks", points, config.min_landmarks, True, "too_few_landmarks", ADVICE["too_few_landmarks"]),
        Gate(
            "explained_share",
            explained,
            config.min_explained,
            True,
            "no_consistent_motion",
            "too much of what is seen moves by itself or has no measurable depth: look at what stands still, and near",
        ),
        Gate("further_views", len(bundle.problem.frames) - 2, 1, True, "no_third_view", ADVICE["no_third_view"]),
        Gate(
            "further_agreement",
            candidate.agreement,
            config.min_further_agreement,
            True,
            "no_third_view",
            "further views contradict the pair: move more slowly, and look at what stands still",
        ),
    ]
    failed = [gate for gate in gates if not gate.passes()]
    return (failed[0].reason if failed else ACCEPTED), gates


def direction_bound_deg(candidate: MapCandidate, bundle: BundleSolution, shared_turn_rad: float) -> float:
    """How far the direction of a baseline from the first view may be off, for the worst view, in degrees.

    Three standard deviations, and what no average removes: an error that neighbouring tracks share (lens model, blur,
    the tracker's interpolation) is each view's own, and turns a baseline by the more the shorter it is.
    """
    sigmas_deg, lengths = direction_sigmas_deg(bundle)
    first, second = _pair(candidate, bundle)
    share = lengths / max(float(np.linalg.norm(second.t - first.t)), 1e-300)
    return float(np.max(np.hypot(3 * sigmas_deg, np.degrees(shared_turn_rad) / share)))


def direction_focal_deg(camera: Camera, candidate: MapCandidate, bundle: BundleSolution, focal_error: float) -> float:
    """By how much the baseline of the pair turns where the focal length is off by a share, in degrees.

    Either way, whichever is worse. Compared is what epipolar lines say, with the error and without: the motion of a
    plane obeys the plane as well, and is another estimate. A focal length that was adjusted is off by three of its
    standard deviations.
    """
    if bundle.focal_factor_sigma is not None:
        camera, focal_error = bundle.camera, 3 * bundle.focal_factor_sigma
    motion = candidate.hypothesis
    pixels = candidate.table.pixels[:2, motion.inliers]

    def direction(R: Floats, t: Floats, factor: float) -> tuple[Floats, Floats]:
        turned = camera_with_focal_factor(camera, factor)
        m, n = (turned.bearings(seen) for seen in pixels)
        known = np.isfinite(m).all(axis=1) & np.isfinite(n).all(axis=1)
        return refine_pose(R, t, m[known], n[known], 3 * bundle.noise_px / camera.focal_px)

    R, t = direction(motion.R, motion.t, 1.0)
    cosine = min(float(t @ direction(R, t, 1 + sign * focal_error)[1]) for sign in (-1, 1))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def direction_shift_deg(candidate: MapCandidate, bundle: BundleSolution) -> float:
    """By how much the adjustment turned the baseline of the pair: two estimates of one thing should agree.

    The two-view estimate and the adjusted one weigh the data differently (a plane's constraint, further views). Where
    they differ by more than the error that is allowed, one of them is that wrong.
    """
    first, second = _pair(candidate, bundle)
    adjusted = (second.inverse() @ first).t
    cosine = float(adjusted @ candidate.hypothesis.t) / max(float(np.linalg.norm(adjusted)), 1e-300)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def direction_sigmas_deg(bundle: BundleSolution) -> tuple[Floats, Floats]:
    """The baselines from the first view: standard deviation of their direction (degrees), and their length.

    Baselines under 0.3 of the longest are left out.
    """
    poses = bundle.problem.world_from_cam
    lengths = np.array([np.linalg.norm(pose.t - poses[0].t) for pose in poses])
    sigmas, kept = [], []
    for pose, covariance, length in zip(poses, bundle.pose_covariances, lengths, strict=True):
        if length < _SHORT_BASELINE * lengths.max() or length == 0:
            continue
        along = (pose.t - poses[0].t) / length
        across = np.eye(3) - np.outer(along, along)
        in_world = across @ pose.R @ covariance[3:, 3:] @ pose.R.T @ across
        sigmas.append(float(np.degrees(np.sqrt(np.linalg.eigvalsh(in_world)[-1]) / length)))
        kept.append(float(length))
    return np.array(sigmas), np.array(kept)


def _pair(candidate: MapCandidate, bundle: BundleSolution) -> tuple[Pose, Pose]:
    """``world_from_cam`` of the pair, as adjusted."""
    pose_of = dict(zip(bundle.problem.frames, bundle.problem.world_from_cam, strict=True))
    first, second = candidate.table.frames[:2]
    return pose_of[first], pose_of[second]


def depth_sigma(camera: Camera, bundle: BundleSolution) -> float:
    """Median over the landmarks of the relative standard deviation of the depth, from parallax and noise."""
    parallax = bundle.problem.parallax_rad()
    return float(np.median(np.sqrt(2) * bundle.noise_px / camera.focal_px / np.maximum(parallax, 1e-12)))
