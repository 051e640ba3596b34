"""The factor graph of a map in another unit, with the standard deviation of its scale; the joint covariance of poses.

A projection factor does not know the unit. Three kinds of factors do: the prior that holds the first pose, the range
that holds the distance from the first camera to the farthest one, and the priors of further poses. In metres, the range
is the known distance, and its standard deviation is that of the scale. So the range is the prior of the scale, and
whoever goes on with the graph keeps what is known of it.
"""

from __future__ import annotations

import gtsam
import numpy as np

from slam_init.bundle.graph import pose_key
from slam_init.types.arrays import Floats

#: The prior of a further pose states a direction, and the range states the length. The deviation of such a prior along
#: the baseline is so many times that of the scale, so that ten of them change the latter by a twentieth.
_LOOSE = 10.0
#: Standard deviation of a landmark over its distance, where nothing else determines it. gtsam refuses a landmark whose
#: depth is known worse than its ray by a factor of 4096, which is 0.8 at a noise of 0.1 px and a focal length of 500
#: px. The variances of the poses change by some per cent.
_LOOSE_LANDMARK = 0.5


def metric_graph(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, factor: float, sigma: float
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Change the unit of a graph of :func:`slam_init.bundle.graph.build_graph`.

    * ``sigma``: Relative standard deviation of the factor; that of the range of the result.
    """
    scaled = gtsam.Values(values)
    for key in values.keys():  # noqa: SIM118  # no dictionary
        kind = chr(gtsam.Symbol(key).chr())
        if kind == "x":
            pose = values.atPose3(key)
            scaled.update(key, gtsam.Pose3(pose.rotation(), factor * pose.translation()))
        elif kind == "l":
            scaled.update(key, factor * values.atPoint3(key))
    changed = gtsam.NonlinearFactorGraph(graph)
    first = None
    for position in range(graph.size()):
        old = graph.at(position)
        if isinstance(old, gtsam.PriorFactorPose3):
            first = old.prior() if first is None else first
            changed.replace(position, _scaled_prior(old, first, factor, sigma))
        elif isinstance(old, gtsam.RangeFactorPose3):
            a, b = old.keys()
            length = factor * float(old.measured())
            noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma * length)
            changed.replace(position, gtsam.RangeFactorPose3(a, b, length, noise))
    return changed, scaled


def _scaled_prior(
    old: gtsam.PriorFactorPose3, first: gtsam.Pose3, factor: float, sigma: float
) -> gtsam.PriorFactorPose3:
    """A prior of a pose in the new unit; that of a further pose leaves the length of its baseline to the range."""
    mean = gtsam.Pose3(old.prior().rotation(), factor * old.prior().translation())
    sigmas = np.array(old.noiseModel().sigmas())
    baseline = mean.rotation().unrotate(mean.translation() - factor * first.translation())
    length = float(np.linalg.norm(baseline))
    if length <= sigmas[3:].max() * factor:  # the first pose, which the gauge holds
        return old if factor == 1.0 else gtsam.PriorFactorPose3(old.keys()[0], mean, old.noiseModel())
    sigmas[3:] *= factor
    along = baseline / length
    covariance = np.diag(sigmas**2)
    covariance[3:, 3:] += (_LOOSE * sigma * length) ** 2 * np.outer(along, along)
    return gtsam.PriorFactorPose3(old.keys()[0], mean, gtsam.noiseModel.Gaussian.Covariance(covariance))


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
