"""The factor graph of bundle adjustment.

Variables: ``X(frame)`` are poses world_from_cam, ``L(track)`` are landmarks, ``K(0)`` is the calibration where the lens
has a prior; otherwise the calibration is held.

Gauge: a tight prior holds the first pose. A range factor holds the distance between the first camera and the one
farthest from it. A projection does not know the unit; in metres, the range is the known distance with its deviation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

from slam_init.bundle.problem import BundleProblem, PosePrior
from slam_init.bundle.reprojection import (
    calibration_key,
    gtsam_calibration,
    is_undistorted_first,
    projection,
)
from slam_init.errors import SourceError, plain_line
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.lens import LensPrior
from slam_init.types.pose import Pose

#: Standard deviation that practically fixes a variable; much faster than constrained noise in gtsam.
_GAUGE_SIGMA = 1e-6
#: Relative standard deviation of the range factor. The optimum does not depend on it, as the scale is otherwise free.
#: But a stiff range is a curved constraint along which the optimizer makes only small steps: with 1e-6 it stopped at 2
#: to 4 px from starts 3 px off.
_SCALE_SIGMA = 1e-3
#: The prior of a further pose states a direction, and the range states the length. In a known unit the deviation of
#: such a prior along the baseline is so many times that of the unit, so that ten of them change the latter by a
#: twentieth.
_LOOSE = 10.0
#: Relative standard deviation of fy / fx if the focal length is adjusted. The data determine this ratio to a thousandth
#: at best. With a smaller value, rounding in the elimination destroys the information about the common focal length.
_ASPECT_SIGMA = 1e-5
#: Where the calibrations of gtsam have the principal point and k1, after fx, fy and the skew.
_PRINCIPAL, _K1 = [3, 4], 5
#: A projection of a camera that does not sit on a body differs by rounding.
_SAME_PX = 1e-3
#: A point in the frame of a camera that sees it.
_AHEAD = np.array([0.1, 0.2, 1.0])
#: Standard deviation of a landmark over its distance, where nothing else determines it. gtsam refuses a landmark whose
#: depth is known worse than its ray by a factor of 4096, which is 0.8 at a noise of 0.1 px and a focal length of 500
#: px. The variances of the poses change by some per cent.
_LOOSE_LANDMARK = 0.5
#: The models of gtsam's calibrations, and their distortion in our order.
_LENSES: dict[str, tuple[str, tuple[str, ...]]] = {
    "Cal3_S2": ("pinhole", ()),
    "Cal3DS2": ("radtan", ("k1", "k2", "p1", "p2")),
    "Cal3Fisheye": ("fisheye", ("k1", "k2", "k3", "k4")),
    "Cal3Unified": ("omni", ("xi", "k1", "k2", "p1", "p2")),
}
#: The gauge in words.
GAUGE = "first pose fixed (prior, 1e-6); distance from the first camera to the farthest one held (prior, 1e-3 of it)"


def pose_key(frame: int) -> int:
    """Make the gtsam key ``X(frame)`` of the pose of a keyframe."""
    return int(gtsam.symbol("x", frame))


def landmark_key(track_id: int) -> int:
    """Make the gtsam key ``L(track_id)`` of a landmark."""
    return int(gtsam.symbol("l", track_id))


@dataclass(frozen=True, eq=False)
class GraphRecipe:
    """What the factor graph of a map is built from, when somebody asks for it."""

    camera: Camera
    #: At its optimum.
    problem: BundleProblem
    #: Standard deviation of a coordinate of an observation.
    noise_px: float
    #: If given, the calibration is a variable with this prior; its value is that of ``camera``.
    prior: LensPrior | None = None
    #: The camera that the prior expects; by default ``camera``.
    stated: Camera | None = None
    #: Relative standard deviation of a known unit; None for a map in its own one.
    scale_sigma: float | None = None

    @cached_property
    def graph_and_values(self) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Graph and optimum: reprojection factors, gauge, baseline range, and the priors that there are."""
        camera, problem, adjusted = self.camera, self.problem, self.prior is not None
        noise = gtsam.noiseModel.Isotropic.Sigma(2, self.noise_px)
        factor = projection(camera, problem.pixels, noise, adjusted=adjusted)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        pose_keys = [pose_key(frame) for frame in problem.frames]
        point_keys = [landmark_key(track) for track in problem.track_ids.tolist()]
        for key, pose in zip(pose_keys, problem.world_from_cam, strict=True):
            values.insert(key, gtsam.Pose3(gtsam.Rot3(pose.R), pose.t))
        for key, point in zip(point_keys, problem.points, strict=True):
            values.insert(key, point)
        observed = zip(problem.views.tolist(), problem.landmarks.tolist(), strict=True)
        for number, (k, landmark) in enumerate(observed):
            if (made := factor(number, pose_keys[k], point_keys[landmark])) is not None:
                graph.add(made)
        graph.push_back(_pose_factors(problem, self.scale_sigma))
        if self.prior is not None:
            values.insert(calibration_key(), gtsam_calibration(camera, adjusted=True))
            graph.add(_calibration_prior(self.stated or camera, self.prior))
        return graph, values

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The factor graph."""
        return self.graph_and_values[0]

    @property
    def values(self) -> gtsam.Values:
        """Its optimum."""
        return self.graph_and_values[1]

    def in_unit(self, factor: float, sigma: float) -> GraphRecipe:
        """That of the map in a known unit.

        The range is the prior of the scale then, so that whoever goes on with the graph keeps what is known of it.

        * ``factor``: The known unit over that of the map.
        * ``sigma``: Relative standard deviation of the factor.
        """
        return replace(self, problem=self.problem.scaled(factor), scale_sigma=sigma)

    def enlarged(self, factor: int, camera: Camera, stated: Camera) -> GraphRecipe:
        """That of the map in images that are larger by a whole factor. Each residual over its deviation stays.

        * ``camera, stated``: Of the larger images.
        """
        pixels, prior = factor * (self.problem.pixels + 0.5) - 0.5, self.prior
        if prior is not None:
            prior = replace(prior, principal_sigma_px=factor * prior.principal_sigma_px)
        problem, noise_px = replace(self.problem, pixels=pixels, lenses=None), factor * self.noise_px
        return replace(self, camera=camera, problem=problem, noise_px=noise_px, prior=prior, stated=stated)


def _pose_factors(problem: BundleProblem, scale_sigma: float | None = None) -> gtsam.NonlinearFactorGraph:
    """The factors of poses alone: gauge, baseline range, and the priors that there are."""
    graph = gtsam.NonlinearFactorGraph()
    keys = [pose_key(frame) for frame in problem.frames]
    first = problem.world_from_cam[0]
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
    graph.add(gtsam.PriorFactorPose3(keys[0], gtsam.Pose3(gtsam.Rot3(first.R), first.t), fixed))
    baselines = [float(np.linalg.norm(pose.t - first.t)) for pose in problem.world_from_cam]
    far = int(np.argmax(baselines))
    range_sigma = _SCALE_SIGMA if scale_sigma is None else scale_sigma
    range_noise = gtsam.noiseModel.Isotropic.Sigma(1, range_sigma * baselines[far])
    graph.add(gtsam.RangeFactorPose3(keys[0], keys[far], baselines[far], range_noise))
    if problem.prior is not None:
        for key, pose in zip(keys[1:], problem.expected[1:], strict=True):
            graph.add(_pose_prior(problem.prior, key, pose, pose.t - first.t, scale_sigma))
    return graph


class PoseTerms:
    """The terms of the poses alone in the error of a problem: gauge, baseline range, and the priors that there are.

    * ``problem``: Its poses are the start, which the gauge holds.
    """

    def __init__(self, problem: BundleProblem) -> None:
        self._graph = _pose_factors(problem)
        self._keys = [pose_key(frame) for frame in problem.frames]
        # gtsam sorts the unknowns of a matrix by their keys.
        places = [self._keys.index(key) for key in sorted(self._graph.keyVector())]
        self._columns = np.concatenate([np.arange(6 * place, 6 * place + 6) for place in places])

    def error(self, R: Floats, t: Floats) -> float:
        """The error at some poses.

        Shapes: ``R`` (K, 3, 3), ``t`` (K, 3).
        """
        return float(self._graph.error(self._values(R, t)))

    def equations(self, R: Floats, t: Floats) -> tuple[Floats, Floats]:
        """The equations of a Gauss-Newton step at some poses.

        Shapes: ``R`` (K, 3, 3), ``t`` (K, 3).

        * Returns ``information, gradient``: In gtsam's tangent order (rotation, translation), in the camera frames.
        """
        hessian, descent = self._graph.linearize(self._values(R, t)).hessian()
        size = 6 * len(self._keys)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        information[np.ix_(self._columns, self._columns)] = hessian
        gradient[self._columns] = -np.asarray(descent)
        return information, gradient

    def _values(self, R: Floats, t: Floats) -> gtsam.Values:
        values = gtsam.Values()
        for key, rotation, centre in zip(self._keys, R, t, strict=True):
            values.insert(key, gtsam.Pose3(gtsam.Rot3(rotation), centre))
        return values


def _pose_prior(
    prior: PosePrior, key: int, mean: Pose, baseline: Floats, scale_sigma: float | None
) -> gtsam.NonlinearFactor:
    """A prior of a pose; in a known unit it leaves the length of its baseline to the range."""
    length = float(np.linalg.norm(baseline))
    sigmas = np.repeat([prior.rotation_sigma_rad, prior.direction_sigma_rad * length], 3)
    covariance = np.diag(np.maximum(sigmas, _GAUGE_SIGMA) ** 2)
    if scale_sigma is not None:
        along = _LOOSE * scale_sigma * (mean.R.T @ baseline)
        covariance[3:, 3:] += np.outer(along, along)
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    factor: gtsam.NonlinearFactor = gtsam.PriorFactorPose3(key, gtsam.Pose3(gtsam.Rot3(mean.R), mean.t), noise)
    return factor


def _calibration_prior(camera: Camera, prior: LensPrior) -> gtsam.NonlinearFactor:
    """A prior factor on ``K(0)``: tight for the ratio of the focal lengths, and for all that a lens prior has not."""
    mean = gtsam_calibration(camera, adjusted=True)
    focal = np.array([camera.fx, camera.fy])
    length = float(np.linalg.norm(focal))
    along = focal / length
    whiten = np.eye(mean.dim()) / _GAUGE_SIGMA
    whiten[0, :2] = along / max(prior.focal_sigma * length, _GAUGE_SIGMA)
    whiten[1, :2] = np.array([-along[1], along[0]]) / (_ASPECT_SIGMA * length)
    whiten[_PRINCIPAL, _PRINCIPAL] = 1 / max(prior.principal_sigma_px, _GAUGE_SIGMA)
    whiten[_K1, _K1] = 1 / max(prior.k1_sigma * _unit_of_k1(camera), _GAUGE_SIGMA)
    # gtsam requires the square root of the information matrix in upper triangular form.
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(np.linalg.qr(whiten)[1])
    factor: gtsam.NonlinearFactor = getattr(gtsam, f"PriorFactor{type(mean).__name__}")(calibration_key(), mean, noise)
    return factor


def _unit_of_k1(camera: Camera) -> float:
    """What a k1 of 1 adds to that of the lens model, which may count it in coordinates of its own."""
    if is_undistorted_first(camera) or not camera.distortion:
        return 1.0
    bent = np.array(camera.bent(1.0).distortion)
    return float(np.abs(bent - np.resize((*camera.distortion, *np.zeros(len(bent))), len(bent))).max())


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


@dataclass(frozen=True, eq=False)
class MapOfGraph:
    """The poses and the observations of a factor graph, of any program."""

    #: By the index of the symbol of a pose.
    world_from_cam: dict[int, Pose]
    #: (M,) Of each observation: the index of its pose, and the key of its landmark.
    frames: Ints
    track_ids: Ints
    #: (M, 2)
    pixels: Floats
    camera: Camera


def map_of_graph(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> MapOfGraph:
    """Read the poses, the observations and the calibration of a graph with projection factors.

    gtsam's calibrations have no size of the image: the principal point is taken for its middle.

    Raises
    ------
    SourceError
        If the graph has no observation, a variable without a value, or cameras that differ, are skewed, or sit on a
        body.
    """
    try:
        return _map_of_graph(graph, values)
    except RuntimeError as error:  # gtsam's, which has no class of its own in Python
        raise SourceError(f"the graph and its values do not fit together ({plain_line(str(error))[:200]})") from None


def _map_of_graph(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> MapOfGraph:
    poses, rows = dict[int, Pose](), list[tuple[int, int, float, float]]()
    calibrations, keys = set[tuple[str, tuple[float, ...]]](), dict[int, int]()
    for number in range(graph.size()):
        factor: Any = graph.at(number)
        if not type(factor).__name__.startswith(("GenericProjectionFactor", "GeneralSFMFactor2")):
            continue
        pose_key, point_key, *lens_key = factor.keys()
        kind = type(factor).__name__.removeprefix("GenericProjectionFactor").removeprefix("GeneralSFMFactor2")
        if kind not in _LENSES:
            raise SourceError(f"the graph has a {kind}: give a graph with one of {', '.join(_LENSES)}")
        calibration = getattr(values, f"at{kind}")(lens_key[0]) if lens_key else factor.calibration()
        names = ("fx", "fy", "skew", "px", "py", *_LENSES[kind][1])
        calibrations.add((kind, tuple(float(getattr(calibration, name)()) for name in names)))
        frame, pose = int(gtsam.Symbol(pose_key).index()), values.atPose3(pose_key)
        if keys.setdefault(frame, pose_key) != pose_key:
            raise SourceError(f"the graph has two poses with the number {frame}: give a graph of one camera")
        if frame not in poses:
            poses[frame] = _pose(pose)
            # The wrapper does not state where a sensor sits on its body. The point of the graph may lie behind it.
            ahead = pose.transformFrom(_AHEAD)
            moved = gtsam.Values(values)
            moved.update(point_key, ahead)
            expected = getattr(gtsam, f"PinholeCamera{kind}")(pose, calibration).project(ahead) - factor.measured()
            if np.abs(expected - _error_of(factor, moved)).max() > _SAME_PX:
                raise SourceError("the cameras of the graph sit on a body: give the poses of the cameras")
        rows.append((frame, point_key, *factor.measured().tolist()))
    if not rows:
        raise SourceError("the graph has no projection factor: give a graph with the observations of its points")
    if len(calibrations) > 1:
        raise SourceError(
            f"the graph has {len(calibrations)} calibrations: give a graph of one camera, or handover.npz"
        )
    ((kind, numbers),) = calibrations
    frames, track_ids, x, y = zip(*rows, strict=True)
    return MapOfGraph(
        poses,
        np.array(frames, np.int64),
        np.array(track_ids, np.uint64).astype(np.int64),
        np.array([x, y], float).T.copy(),
        _camera_of(kind, numbers),
    )


def _error_of(factor: Any, values: gtsam.Values) -> Floats:
    """The error of an observation; infinite where the point is behind the camera."""
    try:
        return np.asarray(factor.unwhitenedError(values), float)
    except RuntimeError:
        return np.full(2, np.inf)


def _camera_of(kind: str, numbers: tuple[float, ...]) -> Camera:
    fx, fy, skew, cx, cy, *distortion = numbers
    if skew != 0:
        raise SourceError(f"the calibration of the graph has a skew of {skew:g}: undistort the images")
    return Camera(_LENSES[kind][0], round(2 * cx + 1), round(2 * cy + 1), fx, fy, cx, cy, tuple(distortion))


def _pose(pose3: gtsam.Pose3) -> Pose:
    return Pose(np.asarray(pose3.rotation().matrix(), float), np.asarray(pose3.translation(), float))
