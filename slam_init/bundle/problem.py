"""Input of bundle adjustment (problem, prior of the focal length) and its result (solution or failure).

A failure is a value with its cause, not an exception.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

__all__ = ["BundleFailure", "BundleFit", "BundleProblem", "BundleSolution", "FocalPrior", "PosePrior"]


@dataclass(frozen=True)
class PosePrior:
    """What is known of the poses besides the landmarks: by tracks that are no landmarks, or by a plane.

    Attributes
    ----------
    rotation_sigma_rad : float
        Standard deviation of the rotation from the reference to a view.
    direction_sigma_rad : float
        Standard deviation of the direction of the baseline of a view.
    """

    rotation_sigma_rad: float
    direction_sigma_rad: float


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Views, landmarks and the observations that join them.

    Attributes
    ----------
    frames : tuple of int
        Absolute frame indices of the K views; the first is the reference.
    world_from_cam : tuple of K Pose
    points : (L, 3) float
        Landmarks in the world frame.
    track_ids : (L,) int
        Track of each landmark.
    views, landmarks : (M,) int
        The view and the landmark of each observation, as positions in ``frames`` and in ``points``.
    pixels : (M, 2) float
        Raw pixels of the observations.
    prior : PosePrior or None
        Of the poses that the adjustment starts from.
    expected : tuple of K Pose
        The mean of the prior, world_from_cam; empty without one.
    lenses : (M, 3, 3) float or None
        Of :func:`slam_init.bundle.least_squares.with_lenses`: maps a point in the camera to homogeneous coordinates in
        the virtual camera of the observation, in pixels. Its third row is the measured ray. NaN for a pixel without a
        ray.
    """

    frames: tuple[int, ...]
    world_from_cam: tuple[Pose, ...]
    points: Floats
    track_ids: Ints
    views: Ints
    landmarks: Ints
    pixels: Floats
    prior: PosePrior | None = None
    expected: tuple[Pose, ...] = ()
    lenses: Floats | None = None

    def with_prior(self, prior: PosePrior) -> BundleProblem:
        """Take the poses as the mean of a prior.

        Parameters
        ----------
        prior : PosePrior

        Returns
        -------
        BundleProblem
        """
        return replace(self, prior=prior, expected=self.world_from_cam)

    def residuals(self, camera: Camera) -> Floats:
        """Compute the reprojection residuals.

        Parameters
        ----------
        camera : Camera

        Returns
        -------
        (M, 2) float
            Projected minus observed in raw pixels; NaN where the camera does not see the landmark.
        """
        predicted = np.full((len(self.views), 2), np.nan)
        for k, pose in enumerate(self.world_from_cam):
            seen = self.views == k
            predicted[seen] = camera.project(pose.inverse().apply(self.points[self.landmarks[seen]]))
        return predicted - self.pixels

    def parallax_rad(self) -> Floats:
        """Compute the parallax of each landmark.

        Returns
        -------
        (L,) float
            Largest angle between two rays of the landmark, radians.
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

        Parameters
        ----------
        observations : (M,) bool
            The observations to keep.

        Returns
        -------
        BundleProblem
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

    def scaled(self, factor: float) -> BundleProblem:
        """Change the unit of length.

        Parameters
        ----------
        factor : float
            Factor on all points and translations.

        Returns
        -------
        BundleProblem
        """
        poses, expected = (
            tuple(Pose(pose.R, factor * pose.t) for pose in some) for some in (self.world_from_cam, self.expected)
        )
        return replace(self, world_from_cam=poses, points=factor * self.points, expected=expected)


class FocalPrior(NamedTuple):
    """Prior of the focal length: the stated camera, and the relative standard deviation of its focal length."""

    camera: Camera
    sigma: float


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
    """An adjusted map. Truthy.

    Attributes
    ----------
    problem : BundleProblem
        With adjusted poses and points and without outliers.
    before : BundleProblem
        The same views and landmarks before adjustment, in about the same scale.
    noise_px : float
        Standard deviation of one coordinate, estimated from the residuals and their degrees of freedom.
    rmse_px : float
        Root mean square of the 2-D residuals.
    errors : tuple of float
        Root mean square residual in pixels at the start and after each iteration. In the robust stage these are the
        residuals after the robust kernel.
    graph, values : gtsam.NonlinearFactorGraph, gtsam.Values
        The final factor graph and its optimum.
    pose_covariances : (K, 6, 6) float
        In gtsam's tangent order (rotation, translation), in the camera frame.
    point_covariances, seen_covariances : (L, 3, 3) float
        Of the landmarks, in the world and in the frame of the newest camera, for a held focal length.
    depth_sigmas : (L,) float
        Relative standard deviations of the distances from the newest camera.
    unknown_depths : int
        Number of landmarks that were left out, because these deviations are larger than ``max_depth_sigma``.
    camera : Camera
        The camera of this map: the stated one, or the one with the adjusted focal length.
    gauge : str
        The variables that are held, and how.
    focal_factor : float
        The adjusted focal length over the stated one; 1 if the focal length was held.
    focal_factor_sigma : float or None
        Standard deviation of ``focal_factor`` from the noise of the tracks and the prior; None if the focal length was
        held.
    """

    problem: BundleProblem
    before: BundleProblem
    noise_px: float
    rmse_px: float
    errors: tuple[float, ...]
    graph: Any
    values: Any
    pose_covariances: Floats
    point_covariances: Floats
    seen_covariances: Floats
    depth_sigmas: Floats
    unknown_depths: int
    camera: Camera
    gauge: str
    focal_factor: float = 1.0
    focal_factor_sigma: float | None = None

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True)
class BundleFailure:
    """The reason why there is no adjusted map. Falsy.

    Attributes
    ----------
    cause : str
        One line.
    """

    cause: str

    def __bool__(self) -> bool:
        return False
