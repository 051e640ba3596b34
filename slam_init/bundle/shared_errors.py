"""Errors of the observations that are not independent, as one factor on the noise: the overdispersion.

A graph states independent noise. Two kinds of errors do not average out as it says:

1. **Errors that a track keeps from view to view** (drift, uneven or anisotropic noise). They follow from the scatter of
   the scores over the tracks. The score of a track is its part of the gradient of the cost by the poses, which is 0 in
   the sum. With independent noise, the scores scatter as the information H says.
2. **Errors that the tracks of a view share** (lens model, shutter, stabilizer, the bias of subpixel positions). A
   smooth field of each view describes them: two polynomials of degree two, whose twelve coefficients have the standard
   deviation q. The tracks determine q by the probability of the residuals, with poses, points and lens integrated out.

The covariances of a map (:mod:`slam_init.bundle.covariances`) have both: with the factor r on the variance of the noise
and the response S of the poses to the fields, that of the poses is ``r H^-1 + q^2 S S^T``. A graph of reprojection
factors has independent noise only. No factor on it has this shape: the one with the same mean over all directions of
the poses is ``r + q^2 tr(H S S^T) / n`` with n unknowns. So the graph covers poses in the mean, and points by more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_init.bundle.covariances import (
    FIELD,
    LENS,
    ErrorModel,
    SharedEquations,
    at_projections,
    causes_of_poses,
    inverse_of_poses,
    lens_prior,
    root_of_lens,
    shared_equations,
)
from slam_init.bundle.graph import PoseTerms
from slam_init.bundle.least_squares import state_of
from slam_init.bundle.problem import BundleProblem
from slam_init.config import MapConfig
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Bools, Floats, evenly_spaced
from slam_init.types.camera import Camera
from slam_init.types.correlated_errors import CorrelatedErrors
from slam_init.types.lens import LensPrior

#: A factor needs some hundred landmarks, not all. The covariance of the fields is scaled to the number of all.
_LANDMARKS = 200
#: A view with fewer of these keeps all its landmarks: six fix a pose, and the others its noise.
_LEAST_OF_VIEW = 20
#: Landmarks that state the deviation of a located rotation: on Tsukuba half as many again change it by less than a
#: tenth, and each frame pays.
#: Class: budget.
_LANDMARKS_OF_FRAME = 100
#: What singular equations raise.
_NOT_DETERMINED = (RuntimeError, np.linalg.LinAlgError)


def error_model(
    camera: Camera, projected: BundleProblem, measured: BundleProblem, noise_px: float, lens: LensPrior
) -> ErrorModel:
    """Estimate the errors of the observations from the residuals.

    * ``projected``: The problem at its optimum, of :func:`slam_init.bundle.covariances.at_projections`.
    * ``measured``: The same problem with what was measured.
    """
    chosen = _chosen_landmarks(projected, _LANDMARKS)
    kept = chosen[projected.landmarks]
    part = projected.keep(kept)
    with single_threaded():
        equations = _Equations(part, shared_equations(camera, part, noise_px, measured.keep(kept)))
        by_tracks = max(equations.scatter_of_scores(), 1.0)
        mean_square = equations.mean_square_of_fields(by_tracks, lens.sigmas)
        gain = equations.gain_of_fields(len(chosen) / max(int(chosen.sum()), 1))
    excess = 1 + mean_square * gain / by_tracks
    return ErrorModel(noise_px, math.sqrt(by_tracks), lens, math.sqrt(mean_square), excess)


def _chosen_landmarks(problem: BundleProblem, count: int) -> Bools:
    """Some landmarks (L,), evenly spaced, and all of a view that would be left with too few to fix its pose."""
    chosen = np.zeros(len(problem.points), bool)
    chosen[evenly_spaced(len(chosen), count)] = True
    seen = np.bincount(problem.views[chosen[problem.landmarks]], minlength=len(problem.frames))
    chosen[problem.landmarks[seen[problem.views] < _LEAST_OF_VIEW]] = True
    return chosen


class _Equations:
    """The equations of poses, lens and fields, points eliminated, in units of the noise."""

    def __init__(self, problem: BundleProblem, found: SharedEquations) -> None:
        self._gauge = PoseTerms(problem).equations(*state_of(problem)[:2])[0]
        self._poses = found.equations.information - self._gauge
        self._coupling, self._gradient, self._scores = found.coupling, found.gradient, found.scores
        flat = found.of_points.reshape(-1, len(found.gradient))
        self._shared = -flat.T @ flat
        for view, own in enumerate(found.own):
            columns = np.r_[:LENS, LENS + FIELD * view : LENS + FIELD * (view + 1)]
            self._shared[np.ix_(columns, columns)] += own

    def scatter_of_scores(self) -> float:
        """Mean variance of the scores of the tracks over that of independent noise, in all directions of the poses."""
        H, scores = self._poses[6:, 6:], self._scores[:, 6:]  # the first pose is held
        units = np.sqrt(np.maximum(np.diag(H), 1e-300))
        strength, axes = np.linalg.eigh(H / np.outer(units, units))
        # The images do not determine the scale, whose information is the smallest.
        along = scores / units @ axes[:, 1:] / np.sqrt(np.maximum(strength[1:], 1e-12))
        # The poses follow the tracks, which lowers scores and residuals alike; the estimate of the noise knows it.
        return float(np.mean(np.sum(along**2, axis=0)))

    def mean_square_of_fields(self, by_tracks: float, lens_sigmas: Floats) -> float:
        """Expected square of a coefficient of the fields, in square pixels, given the residuals.

        * ``by_tracks``: Factor on the variance of the noise.
        """
        follows = inverse_of_poses(self._poses + self._gauge) @ self._coupling
        left = (self._shared - self._coupling.T @ follows) / by_tracks
        pull = (self._gradient - follows.T @ self._scores.sum(axis=0)) / by_tracks
        root = root_of_lens(left[:LENS, :LENS], lens_sigmas)
        of_lens = root @ (root.T @ left[:LENS])
        left, pull = (left - left[:, :LENS] @ of_lens)[LENS:, LENS:], (pull - of_lens.T @ pull[:LENS])[LENS:]
        return CorrelatedErrors.of(left, pull).mean_square

    def gain_of_fields(self, share: float) -> float:
        """Mean factor on the variances of the poses by fields of a square pixel.

        * ``share``: Number of all landmarks over that of these.
        """
        H = share * self._poses
        follows = share * inverse_of_poses(H + self._gauge) @ self._coupling[:, LENS:]
        return float(np.sum(follows * (H @ follows))) / max(len(H) - 7, 1)


@dataclass(frozen=True, eq=False)
class LocatedRotation:
    """How well the rotation of a frame is known that the landmarks of a map locate.

    Landmarks have errors in common: of the keyframes that see them, of the lens, of the tracker. So the noise of a
    frame explains a tenth of the error of its rotation, and less with each frame since the last keyframe. The frame
    joins the covariances of the map (:mod:`slam_init.bundle.covariances`) as one view more, with some of the landmarks.
    """

    camera: Camera
    #: Keyframes that the errors of the observations are known by.
    keyframes: int
    #: None where the tracks do not determine the poses.
    errors: ErrorModel | None

    @staticmethod
    def of(camera: Camera, problem: BundleProblem, config: MapConfig) -> LocatedRotation:
        """By the residuals of the map at its optimum."""
        noise_px = problem.noise_px(problem.residuals(camera), config)
        projected, lens = at_projections(camera, problem), lens_prior(camera, config)
        try:
            errors = error_model(camera, projected, problem, noise_px, lens)
        except _NOT_DETERMINED:
            errors = None
        return LocatedRotation(camera, len(problem.frames), errors)

    def sigma_rad(self, problem: BundleProblem) -> float:
        """Standard deviation of the rotation of the newest view from the first one, where it is largest.

        * ``problem``: The map, with the located frame as its newest view.
        * Returns: pi where the landmarks do not determine it.
        """
        if self.errors is None:
            return math.pi
        chosen = _chosen_landmarks(problem, _LANDMARKS_OF_FRAME)
        part = at_projections(self.camera, problem.keep(chosen[problem.landmarks]))
        try:
            found = shared_equations(self.camera, part, self.errors.by_tracks * self.errors.noise_px)
            with single_threaded():
                poses = causes_of_poses(found, self.errors, inverse_of_poses(found.equations.information))
        except _NOT_DETERMINED:
            return math.pi
        # The noise of all landmarks averages out so much more.
        noise = poses.noise[-6:-3] * math.sqrt(chosen.mean())
        rotation: Floats = np.concatenate([noise, poses.fields[-6:-3], poses.lens[-6:-3]], axis=1)
        return min(math.sqrt(float(np.linalg.eigvalsh(rotation @ rotation.T)[-1])), math.pi)
