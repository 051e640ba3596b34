"""Candidate maps: of the true pose of a general scene, and of the two explanations of a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from make_map import make_poses
from make_scene import CAMERA, CONFIG, cloud, hypothesis, observe, plane, table

from quest import Hypothesis, RelativePose, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.mapping.candidate import MapCandidate, build_candidate
from slam_init.types.frame import Observations
from slam_init.types.pose import Pose

POSES = make_poses(5)
#: Towards the plane in a curve. The plane of the twin is perpendicular to the baseline, so its points lie in front of
#: all cameras only if the camera moves roughly along its optical axis.
TOWARDS = [
    Pose(
        rotation_from_vector(np.array([0.01, -0.02, 0.01]) * k),
        np.array([0.03 * k + 0.012 * k * k, 0.01 * k, 0.09 * k]),
    )
    for k in range(5)
]
ALL = np.ones(120, bool)


def true_hypothesis(poses: Sequence[Pose] = POSES, inliers: np.ndarray = ALL) -> Hypothesis:
    """The true motion between the first and the last camera."""
    return hypothesis(poses[-1].inverse() @ poses[0], inliers)


def build(seen: Sequence[Observations], of: Hypothesis | RelativePose) -> MapCandidate:
    """The map of a motion between the first and the last view, with the others as further views."""
    return build_candidate(CAMERA, CONFIG, table(seen), of)


def general_views(poses: Sequence[Pose] = POSES) -> list[Observations]:
    """Views of a scene in general position."""
    rng = np.random.default_rng(1)
    return observe(CAMERA, poses, cloud(rng), 0.3, rng)


def general_candidate() -> MapCandidate:
    """The map of the true motion of a scene in general position."""
    return build(general_views(), true_hypothesis())


def planar_views(views: int, seed: int = 2) -> list[Observations]:
    """Views of a plane, of which the last is always the same."""
    rng = np.random.default_rng(seed)
    return observe(CAMERA, [*TOWARDS[: views - 1], TOWARDS[-1]], plane(rng, 300), 0.3, rng)


def planar_candidates(views: int, seed: int = 2) -> tuple[MapCandidate, MapCandidate]:
    """The maps of the two explanations of a plane, the true one first."""
    seen = planar_views(views, seed)
    pose = estimate_relative_pose(seen[0].bearings, seen[-1].bearings, threshold_rad=2 / CAMERA.focal_px, seed=0)
    assert isinstance(pose, RelativePose)
    assert pose.kind == "planar"
    assert len(pose.alternatives) == 1
    truth = TOWARDS[-1].inverse() @ TOWARDS[0]
    candidates = [build(seen, each) for each in (pose, *pose.alternatives)]
    off = [rotation_angle(candidate.hypothesis.R.T @ truth.R) for candidate in candidates]
    true, twin = (candidates[k] for k in np.argsort(off))
    return true, twin


def bent(candidate: MapCandidate, angle_deg: float) -> MapCandidate:
    """The same map, with all baselines turned about a vertical axis through the first camera."""
    problem = candidate.bundle.problem
    turn = rotation_from_vector(np.array([0.0, np.deg2rad(angle_deg), 0.0]))
    poses = tuple(Pose(pose.R, turn @ pose.t) for pose in problem.world_from_cam)
    return replace(candidate, bundle=replace(candidate.bundle, problem=replace(problem, world_from_cam=poses)))


def with_noise(candidate: MapCandidate, noise_px: float) -> MapCandidate:
    """The same map, with another estimate of the noise."""
    return replace(candidate, bundle=replace(candidate.bundle, noise_px=noise_px))
