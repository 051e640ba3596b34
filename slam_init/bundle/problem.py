"""Input of bundle adjustment (problem) and its result (solution or failure).

A failure is a value with its cause, not an exception. The covariances of the map are computed with the noise that is
estimated here from the residuals, not with the configured one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slam_init.config import MapConfig
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.initial_map import ScaleUncertainty
from slam_init.types.pose import Pose

#: Median of the squared length of a 2-D Gaussian, in variances.
MEDIAN_SQUARE = 2 * math.log(2)


def min_parallax_rad(camera: Camera, noise_px: float, config: MapConfig) -> float:
    """Compute the least parallax at which the depth of a landmark is as precise as the configuration requires.

    Two rays with noise s each that meet at the angle a give a depth with relative standard deviation sqrt(2) s / a.

    * ``config``: ``max_depth_sigma`` is the largest relative standard deviation of a depth.
    """
    return float(np.sqrt(2) * noise_px / camera.focal_px / config.max_depth_sigma)


@dataclass(frozen=True)
class PosePrior:
    """What is known of the poses besides the landmarks: by tracks that are no landmarks, or by a plane."""

    #: Standard deviation of the rotation from the reference to a view.
    rotation_sigma_rad: float
    #: Standard deviation of the direction of the baseline of a view.
    direction_sigma_rad: float

    def times(self, factor: float) -> PosePrior:
        """The prior with its deviations times a factor."""
        return PosePrior(factor * self.rotation_sigma_rad, factor * self.direction_sigma_rad)


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Views, landmarks and the observations that join them."""

    #: Absolute frame indices of the K views; the first is the reference.
    frames: tuple[int, ...]
    world_from_cam: tuple[Pose, ...]
    #: (L, 3) Landmarks in the world frame.
    points: Floats
    #: (L,) Track of each landmark.
    track_ids: Ints
    #: views, landmarks: (M,) The view and the landmark of each observation, as positions in ``frames`` and in
    #: ``points``.
    views: Ints
    landmarks: Ints
    #: (M, 2) Raw pixels of the observations.
    pixels: Floats
    #: Of the poses that the adjustment starts from.
    prior: PosePrior | None = None
    #: The mean of the prior, world_from_cam; empty without one.
    expected: tuple[Pose, ...] = ()
    #: (M, 3, 3) Of :func:`slam_init.bundle.least_squares.with_lenses`: maps a point in the camera to homogeneous
    #: coordinates in the virtual camera of the observation, in pixels. Its third row is the measured ray. NaN for a
    #: pixel without a ray.
    lenses: Floats | None = None

    def with_prior(self, prior: PosePrior) -> BundleProblem:
        """Take the poses as the mean of a prior."""
        return replace(self, prior=prior, expected=self.world_from_cam)

    @property
    def virtual(self) -> Floats:
        """The virtual cameras ``lenses``, which have been made.

        Shapes: returns (M, 3, 3).
        """
        if self.lenses is None:
            raise ValueError("a problem without lenses: make them by with_lenses")
        return self.lenses

    def residuals(self, camera: Camera) -> Floats:
        """Compute the reprojection residuals.

        Shapes: returns (M, 2).

        * Returns: Projected minus observed in raw pixels; NaN where the camera does not see the landmark.
        """
        predicted = np.full((len(self.views), 2), np.nan)
        for k, pose in enumerate(self.world_from_cam):
            seen = self.views == k
            predicted[seen] = camera.project(pose.inverse().apply(self.points[self.landmarks[seen]]))
        return predicted - self.pixels

    def noise_px(self, residuals: Floats, config: MapConfig) -> float:
        """Estimate the noise from the mean square of residuals without outliers.

        Without outliers this is better than :meth:`robust_noise_px`, whose median is too low for few degrees of
        freedom.

        Shapes: ``residuals`` (M, 2).

        * Returns: Standard deviation of one coordinate of one observation in pixels, at least ``config.min_noise_px``.
        """
        squares = float(np.sum(residuals**2))
        return max(float(np.sqrt(squares / self._freedom(len(residuals)))), config.min_noise_px)

    def robust_noise_px(self, residuals: Floats, config: MapConfig) -> float:
        """Estimate the noise from the median of the residuals, corrected for the number of fitted unknowns.

        Shapes: ``residuals`` (M, 2).

        * Returns: As :meth:`noise_px`.
        """
        norms = np.linalg.norm(residuals, axis=1)
        norms = norms[np.isfinite(norms)]
        if len(norms) == 0:
            return config.noise_px
        raw = float(np.median(norms) / np.sqrt(MEDIAN_SQUARE))
        return max(raw * float(np.sqrt(2 * len(norms) / self._freedom(len(norms)))), config.min_noise_px)

    def _freedom(self, observations: int) -> float:
        """Number of observed coordinates less fitted unknowns, at least a twentieth of the observations.

        An adjusted focal length does not change it: it adds one unknown, and its prior adds one measurement.
        """
        unknowns = 3 * len(self.points) + 6 * (len(self.frames) - 1) - 1
        return max(2.0 * observations - unknowns, 0.05 * observations)

    def parallax_rad(self) -> Floats:
        """Compute the parallax of each landmark.

        Shapes: returns (L,).
        """
        rays = np.full((len(self.points), len(self.frames), 3), np.nan)
        centres = np.array([pose.t for pose in self.world_from_cam])
        d = self.points[self.landmarks] - centres[self.views]
        rays[self.landmarks, self.views] = d / np.linalg.norm(d, axis=1, keepdims=True)
        cosine = np.einsum("lik,ljk->lij", rays, rays)
        least = np.nanmin(cosine, axis=(1, 2)) if len(rays) else np.zeros(0)
        return np.asarray(np.arccos(np.clip(least, -1, 1)))

    def keep(self, observations: Bools) -> BundleProblem:
        """Keep some observations, and the landmarks that at least two views still see.

        Shapes: ``observations`` (M,).
        """
        counts = np.bincount(self.landmarks[observations], minlength=len(self.points))
        kept = counts >= 2
        chosen = observations & kept[self.landmarks]
        renumbered = np.cumsum(kept) - 1
        return replace(
            self,
            points=self.points[kept],
            track_ids=self.track_ids[kept],
            views=self.views[chosen],
            landmarks=renumbered[self.landmarks[chosen]],
            pixels=self.pixels[chosen],
            lenses=None if self.lenses is None else self.lenses[chosen],
        )

    def with_view(self, frame: int, world_from_cam: Pose, landmarks: Ints, pixels: Floats) -> BundleProblem:
        """Add a view as the newest one, without virtual cameras.

        Shapes: ``landmarks`` (N,), ``pixels`` (N, 2).
        """
        longer = replace(self, frames=(*self.frames, frame), world_from_cam=(*self.world_from_cam, world_from_cam))
        return longer.with_observations(len(self.frames), landmarks, pixels)

    def with_observations(self, view: int, landmarks: Ints, pixels: Floats) -> BundleProblem:
        """Add observations of a view, without virtual cameras.

        Shapes: ``landmarks`` (N,), ``pixels`` (N, 2).
        """
        return replace(
            self,
            views=np.concatenate([self.views, np.full(len(landmarks), view)]),
            landmarks=np.concatenate([self.landmarks, landmarks]),
            pixels=np.concatenate([self.pixels, pixels]),
            lenses=None,
        )

    def scaled(self, factor: float) -> BundleProblem:
        """Change the unit of length."""
        poses, expected = (
            tuple(Pose(pose.R, factor * pose.t) for pose in some) for some in (self.world_from_cam, self.expected)
        )
        return replace(self, world_from_cam=poses, points=factor * self.points, expected=expected)


class BundleFit(NamedTuple):
    """A problem at its optimum for a camera, and the root mean square residual (pixels) after each iteration.

    ``unknown_depths``: number of landmarks that were left out since their depths are not known.
    """

    camera: Camera
    problem: BundleProblem
    errors: tuple[float, ...]
    unknown_depths: int = 0


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """An adjusted map. Truthy."""

    #: With adjusted poses and points and without outliers.
    problem: BundleProblem
    #: The same views and landmarks before adjustment, in about the same scale.
    before: BundleProblem
    #: Standard deviation of one coordinate, estimated from the residuals and their degrees of freedom.
    noise_px: float
    #: Root mean square of the 2-D residuals.
    rmse_px: float
    #: Root mean square residual in pixels at the start and after each iteration. In the robust stage these are the
    #: residuals after the robust kernel.
    errors: tuple[float, ...]
    #: Of the final factor graph (:class:`slam_init.bundle.graph.GraphRecipe`).
    recipe: Any
    #: Standard deviation of the noise of the graph over ``noise_px`` (:mod:`slam_init.bundle.shared_errors`).
    overdispersion: float
    #: (K, 6, 6) In gtsam's tangent order (rotation, translation), in the camera frame.
    pose_covariances: Floats
    #: (L, 3, 3) Of the landmarks in the world.
    point_covariances: Floats
    #: (L,) Relative standard deviations of the distances from the newest camera.
    depth_sigmas: Floats
    scale_uncertainty: ScaleUncertainty
    #: seen_covariances, seen_depth_sigmas: Of the landmarks in the frame of the newest camera, (L, 3, 3) and (L,), by
    #: the noise of single tracks alone. The next view has the same lens, and nearly the same shared errors.
    seen_covariances: Floats
    seen_depth_sigmas: Floats
    #: Number of landmarks that were left out: the noise alone leaves their depths unknown (``max_depth_sigma``), or
    #: nothing tests them.
    unknown_depths: int
    #: The camera of this map: the stated one, or the one with the adjusted focal length.
    camera: Camera
    #: The adjusted focal length over the stated one; 1 if the focal length was held.
    focal_factor: float = 1.0
    #: Standard deviation of ``focal_factor`` from the noise of the tracks and the prior; None if the focal length was
    #: held.
    focal_factor_sigma: float | None = None

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True)
class BundleFailure:
    """The reason why there is no adjusted map. Falsy."""

    #: One line.
    cause: str
    #: The view that sees too few landmarks, where this is the cause.
    frame: int | None = None

    def __bool__(self) -> bool:
        return False
