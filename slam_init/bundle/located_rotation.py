"""How well the rotation of a frame is known that the landmarks of a map locate.

Landmarks have errors in common: of the keyframes that see them, of the lens, of the tracker. So the noise of a frame
explains a tenth of the error of its rotation, and less with each frame since the last keyframe. The frame joins the
covariances of the map (:mod:`slam_init.bundle.covariances`) as one view more, with some of the landmarks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_init.bundle.covariances import causes_of_poses, inverse_of_poses, shared_equations
from slam_init.bundle.lens import at_projections, lens_derivatives, lens_prior
from slam_init.bundle.noise import least_squares_noise
from slam_init.bundle.problem import BundleProblem
from slam_init.bundle.shared_errors import ErrorModel, chosen_landmarks, error_model
from slam_init.config import MapConfig
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.correlated_errors import orthonormal_polynomials

#: Landmarks that state a deviation: on Tsukuba half as many again change it by less than a tenth, and each frame pays.
#: Class: budget.
_LANDMARKS = 100
#: What singular equations raise.
_NOT_DETERMINED = (RuntimeError, np.linalg.LinAlgError)


@dataclass(frozen=True, eq=False)
class LocatedRotation:
    """What is known of the errors of the observations of a map."""

    camera: Camera
    #: Keyframes that it is known by.
    keyframes: int
    noise_px: float
    #: None where the tracks do not determine the poses.
    errors: ErrorModel | None

    @staticmethod
    def of(camera: Camera, problem: BundleProblem, config: MapConfig) -> LocatedRotation:
        """By the residuals of the map at its optimum."""
        noise_px = least_squares_noise(problem, problem.residuals(camera), config)
        projected, lens = at_projections(camera, problem), lens_prior(camera, config)
        try:
            errors = error_model(camera, projected, problem, noise_px, lens)
        except _NOT_DETERMINED:
            errors = None
        return LocatedRotation(camera, len(problem.frames), noise_px, errors)

    def sigma_rad(self, problem: BundleProblem) -> float:
        """Standard deviation of the rotation of the newest view from the first one, where it is largest.

        * ``problem``: The map, with the located frame as its newest view.
        * Returns: pi where the landmarks do not determine it.
        """
        if self.errors is None:
            return math.pi
        chosen = chosen_landmarks(problem, _LANDMARKS)
        part = at_projections(self.camera, problem.keep(chosen[problem.landmarks]))
        shared = self.errors.shared._replace(
            by_lens=lens_derivatives(self.camera, part), places=orthonormal_polynomials(self.camera, part.pixels)
        )
        try:
            found = shared_equations(part, self.errors.by_tracks * self.noise_px, shared)
            with single_threaded():
                poses = causes_of_poses(found, shared, inverse_of_poses(found.equations.information))
        except _NOT_DETERMINED:
            return math.pi
        # The noise of all landmarks averages out so much more.
        noise = poses.noise[-6:-3] * math.sqrt(chosen.mean())
        rotation: Floats = np.concatenate([noise, poses.fields[-6:-3], poses.lens[-6:-3]], axis=1)
        return min(math.sqrt(float(np.linalg.eigvalsh(rotation @ rotation.T)[-1])), math.pi)
