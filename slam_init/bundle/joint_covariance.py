"""The joint covariance of the poses of a graph."""

from __future__ import annotations

import gtsam
import numpy as np

from slam_init.bundle.graph import pose_key
from slam_init.types.arrays import Floats

#: Standard deviation of a landmark over its distance, where nothing else determines it. gtsam refuses a landmark whose
#: depth is known worse than its ray by a factor of 4096, which is 0.8 at a noise of 0.1 px and a focal length of 500
#: px. The variances of the poses change by some per cent.
_LOOSE_LANDMARK = 0.5


def joint_pose_covariance(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, frames: tuple[int, ...]) -> Floats:
    """Compute the joint covariance of poses.

    * Returns: In gtsam's tangent order (rotation, translation) in the camera frames, keyframe by keyframe.
    """
    try:
        marginals = gtsam.Marginals(graph, values)
    except RuntimeError:  # a landmark near infinity is not determined in double precision
        marginals = gtsam.Marginals(_with_loose_landmarks(graph, values), values)
    joint = marginals.jointMarginalCovariance([pose_key(frame) for frame in frames])
    return np.asarray(joint.fullMatrix(), float)


def _with_loose_landmarks(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """The same graph with a prior on each landmark that is weaker than two views."""
    held = gtsam.NonlinearFactorGraph(graph)
    for key in values.keys():  # noqa: SIM118  # no dictionary
        if chr(gtsam.Symbol(key).chr()) == "l":
            point = values.atPoint3(key)
            noise = gtsam.noiseModel.Isotropic.Sigma(3, _LOOSE_LANDMARK * max(float(np.linalg.norm(point)), 1e-9))
            held.add(gtsam.PriorFactorPoint3(key, point, noise))
    return held
