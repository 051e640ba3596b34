"""Decision rules for an adjusted map: gates on the direction of the baselines, the depths, the landmarks, the views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quest.geometry.refine import refine_pose
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.bundle.problem import BundleSolution
from slam_init.config import AcceptanceConfig
from slam_init.decision.refusal import refused_by, with_gates
from slam_init.mapping.candidate import MapCandidate
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.evidence import MapEvidence
from slam_init.types.gates import Gate, GateName, Stage, at_least, at_most
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

__all__ = [
    "depth_sigma",
    "direction_bound_deg",
    "direction_focal_deg",
    "direction_shift_deg",
    "direction_sigmas_deg",
    "judge_map",
    "map_gates",
]

#: A baseline shorter than this share of the longest one is left out, because its direction is too uncertain.
_SHORT_BASELINE = 0.3


def judge_map(
    camera: Camera,
    attempt: Attempt,
    candidate: MapCandidate,
    bundle: BundleSolution,
    correlated_turn_rad: float,
    near_rival_deg: float,
    config: AcceptanceConfig,
    *,
    third_view: bool = True,
) -> Attempt:
    """Refuse a map that does not pass all gates.

    Parameters
    ----------
    camera : Camera
    attempt : Attempt
    candidate : MapCandidate
        The best map.
    bundle : BundleSolution
        The adjusted map of the candidate.
    correlated_turn_rad : float
        Angle by which correlated tracking errors may turn the baseline of the pair.
    near_rival_deg : float
        Angle between the baselines of the map and of a nearly equal rival that could not be ruled out.
    config : AcceptanceConfig
    third_view : bool
        Without a third view the gates that ask for one are ignored.

    Returns
    -------
    Attempt
        With the gates of the map, and its verdict.
    """
    gates = map_gates(camera, candidate, bundle, correlated_turn_rad, near_rival_deg, config)
    attempt = replace(
        with_gates(attempt, gates),
        map=MapEvidence(reprojection_rmse_px=bundle.rmse_px),
        parallax_shortfall=max(gate.parallax_shortfall() for gate in gates),
    )
    failed = next((gate for gate in gates if not gate.passes()), None)
    if failed is None or (failed.reason == Verdict.NO_THIRD_VIEW and not third_view):
        return attempt
    return refused_by(attempt, Stage.MAP, gates)


def map_gates(
    camera: Camera,
    candidate: MapCandidate,
    bundle: BundleSolution,
    correlated_turn_rad: float,
    near_rival_deg: float,
    config: AcceptanceConfig,
) -> tuple[Gate, ...]:
    """Make all gates of an adjusted map, in the order in which they are reported.

    Parameters
    ----------
    camera : Camera
    candidate : MapCandidate
    bundle : BundleSolution
        The adjusted map of the candidate.
    correlated_turn_rad : float
        Angle by which correlated tracking errors may turn the baseline of the pair.
    near_rival_deg : float
        Angle between the baselines of the map and of a nearly equal rival that could not be ruled out.
    config : AcceptanceConfig

    Returns
    -------
    tuple of Gate
    """
    points = len(bundle.problem.points)
    explained = points / max(len(candidate.table.track_ids), 1)
    return (
        *_direction_gates(camera, candidate, bundle, correlated_turn_rad, near_rival_deg, config),
        at_most(
            GateName.DEPTH_SIGMA,
            depth_sigma(camera, bundle),
            config.max_median_depth_sigma,
            Verdict.LOW_PARALLAX,
            "translate sideways, or come nearer: the depths are too uncertain",
        ),
        at_least(GateName.LANDMARKS, points, config.min_landmarks, Verdict.TOO_FEW_LANDMARKS),
        at_least(
            GateName.EXPLAINED_SHARE,
            explained,
            config.min_explained,
            Verdict.NO_CONSISTENT_MOTION,
            "too many tracks move by themselves or have no measurable depth: look at static objects that are near",
        ),
        at_least(GateName.FURTHER_VIEWS, len(bundle.problem.frames) - 2, 1, Verdict.NO_THIRD_VIEW),
        at_least(
            GateName.FURTHER_AGREEMENT,
            candidate.agreement,
            config.min_further_agreement,
            Verdict.NO_THIRD_VIEW,
            "further views contradict the pair: move more slowly, and look at static objects",
        ),
    )


def _direction_gates(
    camera: Camera,
    candidate: MapCandidate,
    bundle: BundleSolution,
    correlated_turn_rad: float,
    near_rival_deg: float,
    config: AcceptanceConfig,
) -> tuple[Gate, Gate, Gate]:
    """Return the gates on the direction of the baselines."""
    max_deg = config.max_direction_error_deg
    return (
        at_most(
            GateName.DIRECTION_BOUND_DEG,
            direction_bound_deg(candidate, bundle, correlated_turn_rad) + near_rival_deg,
            max_deg,
            Verdict.LOW_PARALLAX,
            "translate sideways: the path is too short for the depth of the scene",
        ),
        at_most(
            GateName.DIRECTION_FOCAL_DEG,
            direction_focal_deg(camera, candidate, bundle, config.focal_error),
            max_deg,
            Verdict.LOW_PARALLAX,
            "the direction of motion depends on the exact focal length: translate further for the same turn",
        ),
        at_most(
            GateName.DIRECTION_SHIFT_DEG,
            direction_shift_deg(candidate, bundle),
            max_deg,
            Verdict.LOW_PARALLAX,
            "two views and all views disagree on the direction of motion: translate further, best sideways",
        ),
    )


def direction_bound_deg(candidate: MapCandidate, bundle: BundleSolution, correlated_turn_rad: float) -> float:
    """Bound the direction error of a baseline from the first view, for the worst view.

    The bound has two parts: three standard deviations by independent noise, and the correlated tracking error, which no
    average removes. Each view has its own correlated error (lens model, blur, interpolation of the tracker). This error
    turns a short baseline more than a long one.

    Parameters
    ----------
    candidate : MapCandidate
    bundle : BundleSolution
    correlated_turn_rad : float
        Angle by which correlated tracking errors may turn the baseline of the pair.

    Returns
    -------
    float
        In degrees.
    """
    sigmas_deg, lengths = direction_sigmas_deg(bundle)
    first, second = _pair(candidate, bundle)
    share = lengths / max(float(np.linalg.norm(second.t - first.t)), 1e-300)
    return float(np.max(np.hypot(3 * sigmas_deg, np.degrees(correlated_turn_rad) / share)))


def direction_focal_deg(camera: Camera, candidate: MapCandidate, bundle: BundleSolution, focal_error: float) -> float:
    """Compute the angle by which the baseline of the pair turns if the focal length is wrong.

    The function refines the pose on epipolar lines alone: with the stated focal length, with a larger one, and with a
    smaller one. It returns the larger angle between the baselines. The pose of the candidate is only the start, because
    on a plane it is an estimate with the plane as a constraint.

    Parameters
    ----------
    camera : Camera
    candidate : MapCandidate
    bundle : BundleSolution
    focal_error : float
        Relative error of the focal length. Where the focal length was adjusted, three of its standard deviations are
        taken instead.

    Returns
    -------
    float
        In degrees.
    """
    if bundle.focal_factor_sigma is not None:
        camera, focal_error = bundle.camera, 3 * bundle.focal_factor_sigma
    motion = candidate.hypothesis
    pixels = candidate.table.pixels[:2, motion.inliers]
    gate_rad = 3 * bundle.noise_px / camera.focal_px
    R, t = _refined_with_focal_factor(camera, 1.0, motion.R, motion.t, pixels, gate_rad)
    cosine = min(
        float(t @ _refined_with_focal_factor(camera, 1 + sign * focal_error, R, t, pixels, gate_rad)[1])
        for sign in (-1, 1)
    )
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _refined_with_focal_factor(
    camera: Camera, factor: float, R: Floats, t: Floats, pixels: Floats, gate_rad: float
) -> tuple[Floats, Floats]:
    """Refine a pose on the epipolar lines of the pixels (2, N, 2) of a pair, with a factor on the focal length."""
    other = camera_with_focal_factor(camera, factor)
    m, n = (other.bearings(seen) for seen in pixels)
    known = np.isfinite(m).all(axis=1) & np.isfinite(n).all(axis=1)
    return refine_pose(R, t, m[known], n[known], gate_rad)


def direction_shift_deg(candidate: MapCandidate, bundle: BundleSolution) -> float:
    """Compute the angle by which bundle adjustment turned the baseline of the pair.

    The two-view estimate and the adjusted one weigh the data differently (constraint of a plane, further views). Where
    they differ by more than the allowed error, one of them is wrong by that much.

    Parameters
    ----------
    candidate : MapCandidate
    bundle : BundleSolution

    Returns
    -------
    float
        In degrees.
    """
    first, second = _pair(candidate, bundle)
    adjusted = (second.inverse() @ first).t
    cosine = float(adjusted @ candidate.hypothesis.t) / max(float(np.linalg.norm(adjusted)), 1e-300)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def direction_sigmas_deg(bundle: BundleSolution) -> tuple[Floats, Floats]:
    """Compute the uncertainty and the length of the baselines from the first view.

    Parameters
    ----------
    bundle : BundleSolution

    Returns
    -------
    sigmas_deg : (B,) float
        Standard deviation of the direction, in degrees.
    lengths : (B,) float
        In units of the map. Baselines under 0.3 of the longest are left out.
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
    """Return the adjusted ``world_from_cam`` of the two views of the pair."""
    pose_of = dict(zip(bundle.problem.frames, bundle.problem.world_from_cam, strict=True))
    first, second = candidate.table.frames[:2]
    return pose_of[first], pose_of[second]


def depth_sigma(camera: Camera, bundle: BundleSolution) -> float:
    """Compute the relative standard deviation of the depths, from parallax and noise.

    Parameters
    ----------
    camera : Camera
    bundle : BundleSolution

    Returns
    -------
    float
        Median over the landmarks.
    """
    parallax = bundle.problem.parallax_rad()
    return float(np.median(np.sqrt(2) * bundle.noise_px / camera.focal_px / np.maximum(parallax, 1e-12)))
