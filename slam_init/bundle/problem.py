"""What bundle adjustment is given, a problem and a prior of the focal length, and what it gives: a map or a cause.

A failure is a value with its cause, no exception.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

__all__ = ["BundleFailure", "BundleFit", "BundleProblem", "BundleSolution", "FocalPrior"]


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Views, landmarks and the observations that join them.

    Attributes
    ----------
    frames : tuple of int
        Absolute frame indices of the views, the first being the reference.
    world_from_cam : tuple of K Pose
    points : (L, 3) float
    track_ids : (L,) int
    views, landmarks : (M,) int
        For each observation its position in ``frames`` and in ``points``.
    pixels : (M, 2) float
        Raw pixels.
    """

    frames: tuple[int, ...]
    world_from_cam: tuple[Pose, ...]
    points: Floats
    track_ids: Ints
    views: Ints
    landmarks: Ints
    pixels: Floats

    def residuals(self, camera: Camera) -> Floats:
        """(M, 2) projected minus observed in raw pixels; NaN where a landmark is behind the camera."""
        predicted = np.full((len(self.views), 2), np.nan)
        for k, pose in enumerate(self.world_from_cam):
            seen = self.views == k
            predicted[seen] = camera.project(pose.inverse().apply(self.points[self.landmarks[seen]]))
        return predicted - self.pixels

    def parallax_rad(self) -> Floats:
        """(L,) largest angle between two rays of a landmark."""
        rays = np.full((len(self.points), len(self.frames), 3), np.nan)
        centres = np.array([pose.t for pose in self.world_from_cam])
        d = self.points[self.landmarks] - centres[self.views]
        rays[self.landmarks, self.views] = d / np.linalg.norm(d, axis=1, keepdims=True)
        cosine = np.einsum("lik,ljk->lij", rays, rays)
        least = np.nanmin(cosine, axis=(1, 2)) if len(rays) else np.zeros(0)
        return np.asarray(np.arccos(np.clip(least, -1, 1)))

    def keep(self, observations: Bools) -> BundleProblem:
        """Only these observations, and only landmarks that two views still see."""
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
        )

    def scaled(self, factor: float) -> BundleProblem:
        """The same map in another unit of length."""
        poses = tuple(Pose(pose.R, factor * pose.t) for pose in self.world_from_cam)
        return replace(self, world_from_cam=poses, points=factor * self.points)


class FocalPrior(NamedTuple):
    """What is known of the focal length beforehand: the stated camera, and a relative standard deviation."""

    camera: Camera
    sigma: float


class BundleFit(NamedTuple):
    """A problem at an optimum, the camera it holds for, and the errors on the way."""

    camera: Camera
    problem: BundleProblem
    errors: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """An adjusted map. Truthy.

    Attributes
    ----------
    problem : BundleProblem
        With adjusted poses and points and without the outliers.
    before : BundleProblem
        The same views, landmarks and scale before adjustment.
    noise_px : float
        Standard deviation of one coordinate, estimated from the residuals and their degrees of freedom.
    rmse_px : float
        Root mean square of the 2-D residuals.
    errors : tuple of float
        Root mean square residual in pixels at the start and after each iteration; while the kernel is robust, of what
        the kernel leaves of the residuals.
    graph, values
        gtsam objects: the final factor graph and its optimum.
    pose_covariances : (K, 6, 6) float
        gtsam's tangent order (rotation, translation) in the camera frame.
    camera : Camera
        With which all this holds: the stated one, or with the adjusted focal length.
    gauge : str
        What is held, and how.
    focal_factor : float
        The adjusted focal length over the stated one; 1 where it was held.
    focal_factor_sigma : float or None
        Its standard deviation, by the noise of the tracks and the prior; None where it was held.
    """

    problem: BundleProblem
    before: BundleProblem
    noise_px: float
    rmse_px: float
    errors: tuple[float, ...]
    graph: Any
    values: Any
    pose_covariances: Floats
    camera: Camera
    gauge: str
    focal_factor: float = 1.0
    focal_factor_sigma: float | None = None

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True)
class BundleFailure:
    """Why there is no adjusted map. Falsy."""

    cause: str

    def __bool__(self) -> bool:
        return False
