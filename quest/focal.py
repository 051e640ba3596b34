"""The pose of two views of one camera whose focal length is not known.

The focal length is the one at which the matches are most probable: a sweep over a range, and a search for the maximum
about the best. At each focal length the motion is the best for it. The likelihood is that of the choice between modes
(:mod:`quest.robust.kernels.mixture`), in pixels, so that it is comparable between focal lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats, as_positive
from quest.estimate import estimate_relative_pose, refine_relative_pose
from quest.noise import GATE_SIGMAS, log_likelihood, refine_with_noise
from quest.relative_pose import NoPose, PoseEvidence, RelativePose
from quest.robust.pose_problem import PoseProblem

Floats = NDArray[np.float64]
#: Distance of the farthest point from the principal point, in each image: from a pixel to a million, more than any
#: decoder gives.
_REACH_PX = (1.0, 1e6)

#: Focal lengths of the sweep, in distances of the farthest match from the principal point: fields of view of 127 to 19
#: degrees. Neighbours differ by a fifth, less than the optimum of a motion allows.
_SWEEP = np.geomspace(0.5, 6.0, 15)
#: Samples of a focal length of the sweep.
_SAMPLES = 512
#: Steps of the golden section: from a fifth of the focal length to a thousandth.
_STEPS = 12
#: First step of the second difference, in the logarithm of the focal length.
_DIFFERENCE = 0.02


@dataclass(frozen=True, eq=False)
class SharedFocal:
    """A focal length that two views share, and their relative pose.

    Attributes
    ----------
    focal_px : float
        The focal length, in pixels.
    sigma_px : float
        Its standard deviation, from the curvature of the residuals; infinite where the matches do not tell it.
    pose : RelativePose
        The pose at this focal length. Its covariance takes the focal length as known.
    """

    focal_px: float
    sigma_px: float
    pose: RelativePose


def estimate_shared_focal(
    points1: ArrayLike, points2: ArrayLike, principal_point: ArrayLike, *, threshold_px: float = 1.5, seed: int = 0
) -> SharedFocal | NoPose:
    """Estimate the focal length and the motion of a camera with square pixels from two of its views.

    Parameters
    ----------
    points1, points2 : (N, 2) array_like
        Matched undistorted pixels (x, y) in image 1 and image 2.
    principal_point : (2,) array_like
        The principal point, mostly the middle of the image.
    threshold_px : float
        A match whose Sampson error is larger is an outlier: about three times the standard deviation of a pixel
        coordinate.
    seed : int
        Seed of the random samples.

    Returns
    -------
    SharedFocal or NoPose
        NoPose where no focal length has a motion with observable translation.

    Raises
    ------
    InputError
        If the points are not two finite arrays (N, 2) of one shape, all lie within a pixel of the principal point or
        one beyond a million pixels from it, the principal point is none, or threshold_px is not positive.
    """
    centred1, centred2 = _centred(points1, points2, principal_point)
    threshold_px = as_positive(threshold_px, "threshold_px", "a positive number of pixels")
    size_px = float(np.sqrt(max(np.sum(centred1**2, axis=1).max(), np.sum(centred2**2, axis=1).max())))

    def problem(focal_px: float) -> PoseProblem:
        both = (np.column_stack([centred / focal_px, np.ones(len(centred))]) for centred in (centred1, centred2))
        m, n = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in both)
        return PoseProblem(m, n, threshold_px / focal_px)

    start = _sweep(problem, size_px, seed)
    if isinstance(start, NoPose):
        return start
    focal_px, first = start

    def refined(log_focal: float) -> tuple[float, Floats]:
        at = problem(float(np.exp(log_focal)))
        model, _ = refine_with_noise(at, first)
        return log_likelihood(at, model), model

    step = float(np.log(_SWEEP[1] / _SWEEP[0]))
    log_focal = float(np.log(focal_px))
    log_focal = _maximum(lambda value: refined(value)[0], log_focal - step, log_focal + step)
    focal_px, model = float(np.exp(log_focal)), refined(log_focal)[1]
    at = problem(focal_px)
    pose = refine_relative_pose(at.m, at.n, (model[:4], model[4:]), threshold_rad=at.threshold_rad, seed=seed)
    if isinstance(pose, NoPose):
        return pose
    if pose.kind == "rotation":
        return NoPose("no_consistent_motion", pose.evidence)
    return SharedFocal(focal_px, focal_px * _sigma_of_log(problem, log_focal, model, pose), pose)


def _sweep(problem: Callable[[float], PoseProblem], size_px: float, seed: int) -> tuple[float, Floats] | NoPose:
    """The focal length of the sweep with the most probable motion, and this motion (q_wxyz, t)."""
    best: tuple[float, Floats] | None = None
    score, evidence = -inf, PoseEvidence(len(problem(size_px)))
    for focal_px in (size_px * _SWEEP).tolist():
        at = problem(focal_px)
        found = estimate_relative_pose(at.m, at.n, threshold_rad=at.threshold_rad, seed=seed, max_samples=_SAMPLES)
        evidence = found.evidence
        if isinstance(found, NoPose):
            if found.reason == "too_few_matches":
                return found
            continue
        if found.kind == "rotation":
            continue
        model = np.concatenate([found.q_wxyz, found.t])
        value = log_likelihood(at, model)
        if value > score:
            best, score = (focal_px, model), value
    return NoPose("no_consistent_motion", evidence) if best is None else best


def _sigma_of_log(
    problem: Callable[[float], PoseProblem], log_focal: float, model: Floats, pose: RelativePose
) -> float:
    """Standard deviation of the logarithm of the focal length; infinite where the residuals do not depend on it."""
    noise_px = pose.noise_rad * float(np.exp(log_focal))

    def squares(value: float) -> float:
        at, noise_rad = problem(float(np.exp(value))), noise_px / float(np.exp(value))
        r2 = at.residuals(at.refine(model, pose.inliers, GATE_SIGMAS * noise_rad))
        return float(np.sum(np.minimum(r2[pose.inliers] / noise_rad**2, GATE_SIGMAS**2)))

    curvature = (squares(log_focal + _DIFFERENCE) + squares(log_focal - _DIFFERENCE) - 2 * squares(log_focal)) / 2
    return _DIFFERENCE / sqrt(curvature) if curvature > 0 else inf


def _centred(points1: ArrayLike, points2: ArrayLike, principal_point: ArrayLike) -> tuple[Floats, Floats]:
    both = [as_floats(points, "the points") for points in (points1, points2)]
    if both[0].shape != both[1].shape or both[0].ndim != 2 or both[0].shape[1] != 2 or not np.isfinite(both).all():
        raise InputError(f"the points have shapes {both[0].shape} and {both[1].shape}: give two finite arrays (N, 2)")
    centre = as_floats(principal_point, "the principal point")
    if centre.shape != (2,) or not np.isfinite(centre).all():
        raise InputError(f"the principal point has shape {centre.shape}: give two finite numbers")
    if len(both[0]) == 0:
        raise InputError("there are no points: give matches")
    centred1, centred2 = both[0] - centre, both[1] - centre
    reach_px = [float(np.abs(centred).max()) for centred in (centred1, centred2)]
    if not _REACH_PX[0] <= min(reach_px) <= max(reach_px) <= _REACH_PX[1]:
        raise InputError(f"the points lie up to {max(reach_px):.3g} px from the principal point: give pixels of images")
    return centred1, centred2


def _maximum(function: Callable[[float], float], low: float, high: float) -> float:
    """The maximum of a function of one number, by the golden section."""
    share = (sqrt(5) - 1) / 2
    places = [high - share * (high - low), low + share * (high - low)]
    values = [function(place) for place in places]
    for _ in range(_STEPS):
        if values[0] > values[1]:
            high, places = places[1], [places[1] - share * (places[1] - low), places[0]]
            values = [function(places[0]), values[0]]
        else:
            low, places = places[0], [places[1], places[0] + share * (high - places[0])]
            values = [values[1], function(places[1])]
    return 0.5 * (low + high)
