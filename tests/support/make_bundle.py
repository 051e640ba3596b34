"""Bundle problems whose truth is known: motions, disturbed starts, and errors of an adjusted map."""

from dataclasses import replace

import gtsam
import numpy as np
from make_scene import CONFIG

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.bundle.graph import landmark_key, pose_key
from slam_init.bundle.least_squares import CAUCHY
from slam_init.bundle.problem import BundleProblem, BundleSolution
from slam_init.types.pose import Pose

#: Configurations with a held and with an adjusted focal length. All else of the lens is exact.
MAP = replace(CONFIG.map, lens_uncertainty=0.0)
FOCAL = replace(MAP, refine_focal=True)
#: Five views of a camera that rotates by 20 degrees while it translates to the side.
ROTATING = [
    Pose(rotation_from_vector(np.array([0.02, -0.08, 0.03]) * i), np.array([0.1 * i, 0.01 * i * i, 0.03 * i]))
    for i in range(5)
]
#: Five views of a camera that translates to the side and does not rotate.
SIDEWAYS = [Pose(np.eye(3), np.array([0.08 * i, 0.0, 0.0])) for i in range(5)]


def read_problem(values: gtsam.Values, problem: BundleProblem) -> BundleProblem:
    """Replace the poses and points of a problem by those of gtsam values."""
    of_frames = [values.atPose3(pose_key(frame)) for frame in problem.frames]
    poses = tuple(Pose(one.rotation().matrix(), np.asarray(one.translation())) for one in of_frames)
    points = np.array([values.atPoint3(landmark_key(track)) for track in problem.track_ids.tolist()])
    return replace(problem, world_from_cam=poses, points=points.reshape(-1, 3))


def disturbed(
    exact: BundleProblem, rng: np.random.Generator, angle_rad: float = 0.0003, length: float = 0.0003
) -> BundleProblem:
    """The same observations with random errors of the poses (except for the first) and of the points."""
    poses = [exact.world_from_cam[0]] + [
        Pose(pose.R @ rotation_from_vector(rng.normal(0, angle_rad, 3)), pose.t + rng.normal(0, length, 3))
        for pose in exact.world_from_cam[1:]
    ]
    return replace(
        exact, world_from_cam=tuple(poses), points=exact.points * rng.normal(1, 0.02, (len(exact.points), 1))
    )


def with_outliers(noisy: BundleProblem, count: int, rng: np.random.Generator) -> tuple[BundleProblem, np.ndarray]:
    """The problem with some observations far off, and the pixels of these."""
    outliers = rng.choice(len(noisy.pixels), count, replace=False)
    pixels = noisy.pixels.copy()
    pixels[outliers] += rng.choice([-1, 1], (count, 2)) * rng.uniform(8, 40, (count, 2))
    return replace(noisy, pixels=pixels), pixels[outliers]


def kept_of(solution: BundleSolution, outliers: np.ndarray) -> int:
    """The number of observations that a solution keeps; none of them is an outlier."""
    kept = {tuple(pixel) for pixel in solution.problem.pixels}
    assert not any(tuple(pixel) in kept for pixel in outliers)
    return len(kept)


def with_kernel(graph: gtsam.NonlinearFactorGraph, observations: int) -> gtsam.NonlinearFactorGraph:
    """The same graph with Cauchy's kernel on its reprojection factors, which come first."""
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY)
    robust = gtsam.NonlinearFactorGraph()
    for number in range(graph.size()):
        factor = graph.at(number)
        if number < observations:
            factor = factor.cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(cauchy, factor.noiseModel()))
        robust.add(factor)
    return robust


def scale_of(solution: BundleSolution, exact: BundleProblem) -> float:
    """Scale of the map: adjusted over true distance of the last camera from the first."""
    return float(np.linalg.norm(solution.problem.world_from_cam[-1].t) / np.linalg.norm(exact.world_from_cam[-1].t))


def map_errors(solution: BundleSolution, exact: BundleProblem) -> tuple[float, float, float]:
    """Errors in the true scale: rotation and direction of the baselines (largest, degrees), points (median)."""
    scale = scale_of(solution, exact)
    pairs = list(zip(solution.problem.world_from_cam, exact.world_from_cam, strict=True))
    rotation = max(rotation_angle(pose.R.T @ true.R) for pose, true in pairs)
    cosines = [pose.t @ true.t / np.linalg.norm(pose.t) / np.linalg.norm(true.t) for pose, true in pairs[1:]]
    points = exact.points[solution.problem.track_ids // 3]
    return (
        float(np.degrees(rotation)),
        float(np.degrees(np.arccos(min(1.0, *cosines)))),
        float(np.median(np.linalg.norm(solution.problem.points - scale * points, axis=1))),
    )
