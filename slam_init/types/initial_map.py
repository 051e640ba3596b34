"""The initial map and its keyframes."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple, Self

import numpy as np

from quest.display import Described
from slam_init.errors import check_type
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.inertial import Gravity
from slam_init.types.pose import Pose
from slam_init.types.scale import Scale

#: Rate of false maps by causes that no model has: posterior mean of the rate of false maps, with the prior of Jeffreys,
#: less the stated one. Of 702 maps of worlds by two authors who had seen nothing of the project, each run once, 7 were
#: false where 1.09 were stated: 7.5 / 703 - 1.09 / 702 (``docs/measurements/blind-runs.md``).
#: Class: measured.
UNMODELLED_RISK = 0.009


def risk_in_words(model_risk: float) -> str:
    """The risk of a map, as the sum of its two parts."""
    risk = min(1.0, model_risk + UNMODELLED_RISK)
    return f"{risk:.2g} that the map is wrong ({model_risk:.2g} by the model, {UNMODELLED_RISK:.2g} by what it lacks)"


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A view of the initial map.

    Attributes
    ----------
    frame : int
        Absolute index of the frame.
    timestamp_s : float
        In seconds.
    name : str
        Name of the image.
    world_from_cam : Pose
    """

    frame: int
    timestamp_s: float
    name: str
    world_from_cam: Pose


class Descriptors(NamedTuple):
    """(L, 32) ORB descriptors of the landmarks of a map, and (L,) whether a landmark has one."""

    orb: Image
    described: Bools


@dataclass(frozen=True, eq=False)
class ScaleUncertainty:
    """The error of the mean distance of the landmarks, relative to the baselines. Errors of single ones average out.

    Attributes
    ----------
    own : float
        Relative standard deviation by the noise, the poses and the smooth errors of the views. NaN where nobody states
        it.
    by_lens : (4,) float
        How far four independent errors of unit variance move it: those of the focal length, of the principal point and
        of k1, as the map knows them. Maps with the same lens have these errors in common.
    """

    own: float = math.nan
    by_lens: Floats = field(default_factory=lambda: np.zeros(4))

    @property
    def sigma(self) -> float:
        """Relative standard deviation by all errors."""
        return math.hypot(self.own, *self.by_lens)

    def with_scale(self, variance: float) -> Self:
        """The same with a scale that is as uncertain besides."""
        return type(self)(math.sqrt(max(self.own**2 + variance, 0.0)), self.by_lens)


class Savable:
    """Base of what :meth:`save` writes."""

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the files that ``slam-init run`` writes for it; ``docs/reference/files.md`` lists them.

        A map is written as trajectory, points, COLMAP model, factor graph and ``handover.npz``. A result is written as
        its maps and ``summary.json``. Either all files are replaced, or none.

        * ``folder``: A folder that is new, empty, or was written by an earlier call or run.
        """
        # By its name: the types import no writer of files.
        import_module("slam_init.output.results").save(self, folder)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class InitialMap(Described, Savable):
    """The initial map: keyframes in time order, landmarks, and the observations of the landmarks in the keyframes.

    The world frame is the camera frame of the first keyframe. The unit of length is the median depth of the landmarks
    in this frame, or the metre where a scale is known (:func:`slam_init.scale.metric_map.in_metres`).

    The defaults are those of a map without landmarks, as of an external program.

    Attributes
    ----------
    keyframes : tuple of K Keyframe
    points : (L, 3) float
        Landmarks in the world frame.
    track_ids : (L,) int
    observation_keyframes : (M,) int
        Position in ``keyframes``.
    observation_landmarks : (M,) int
        Position in ``points``.
    observation_pixels : (M, 2) float
        Raw pixels; with a rolling shutter those of the middle of the readout.
    colors : (L, 3) uint8
        RGB of each landmark, sampled from the images.
    pose_covariances : (K, 6, 6) float
        Marginal covariances of ``world_from_cam`` in gtsam's tangent order (rotation, translation) in the camera
        frame, in the gauge that ``gauge`` names. They hold the noise estimated from the residuals, what the calibration
        leaves open of the lens (``map.lens_uncertainty``), and smooth errors that the tracks of a view share.
    point_covariances : (L, 3, 3) float
        Marginal covariances of ``points`` in the same gauge, with the same errors.
    depth_sigmas : (L,) float
        Relative standard deviations of the distances of the landmarks from the newest keyframe, whose own error is in
        them, with the same errors. Tracks with a depth that the noise alone leaves unknown are no landmarks: they are
        ``open_tracks``.
    scale_uncertainty : ScaleUncertainty
        The error of the mean distance of the landmarks from the newest keyframe: what a unit of the landmarks is in
        units of the baselines.
    open_tracks : Observations
        The tracks of the newest keyframe that have no landmark: their depths are unknown, or they disagree with the
        map. Their bearings are by ``camera``, not corrected for a rolling shutter.
    gauge : str
        The quantities that were held fixed, in words.
    recipe : slam_init.bundle.graph.GraphRecipe or None
        What :attr:`graph` is built from. None for the map of an external program, which has no landmarks.
    points_before : (L, 3) float
        The landmarks as triangulated, before bundle adjustment, in the same frame and scale.
    keyframes_before : tuple of K Pose
        world_from_cam before bundle adjustment.
    bundle_errors : tuple of float
        Root mean square residual in pixels, at the start of bundle adjustment and after each iteration. While the
        kernel is robust, the residuals are those that the kernel has reduced.
    reprojection_rmse_px : float
        Root mean square over observations of the 2-D reprojection error.
    median_parallax_deg : float
        Median over landmarks of the largest angle between two of its rays.
    noise_px : float
        Standard deviation of a coordinate as estimated from the residuals, at least ``map.min_noise_px``.
    scene : str
        ``general`` or ``planar``.
    camera : Camera
        The camera that projects the landmarks to the observations: the stated one, or the same with the adjusted focal
        length. The bearings of :class:`Observations` are those of the stated camera; :meth:`seen_in` returns bearings
        of this camera.
    focal_factor : float
        The adjusted focal length divided by the stated one; 1 if the focal length was held fixed.
    focal_factor_sigma : float or None
        Standard deviation of the factor, from the noise of the tracks and the prior; None if the focal length was held
        fixed.
    scale : Scale or None
        The scale that the map was brought to metres with; None for a map in its own unit.
    model_risk : float or None
        Probability that the map is wrong, by the model of the window: a rotation off by 5 degrees, or a baseline by 15
        degrees. ``acceptance.max_risk`` bounds it. None for undecided maps, and for a method that states none.
    gravity : Gravity or None
        The direction of gravity in the world frame, where it was measured.
    """

    keyframes: tuple[Keyframe, ...]
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    track_ids: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    observation_keyframes: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    observation_landmarks: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    observation_pixels: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    colors: Image = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    pose_covariances: Floats
    point_covariances: Floats = field(default_factory=lambda: np.zeros((0, 3, 3)))
    depth_sigmas: Floats = field(default_factory=lambda: np.zeros(0))
    scale_uncertainty: ScaleUncertainty = field(default_factory=ScaleUncertainty)
    open_tracks: Observations
    gauge: str
    recipe: Any = None
    points_before: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    keyframes_before: tuple[Pose, ...]
    bundle_errors: tuple[float, ...] = ()
    reprojection_rmse_px: float = math.nan
    median_parallax_deg: float = math.nan
    noise_px: float = math.nan
    scene: str = "general"
    camera: Camera
    focal_factor: float = 1.0
    focal_factor_sigma: float | None = None
    scale: Scale | None = None
    model_risk: float | None = None
    gravity: Gravity | None = None

    @property
    def graph(self) -> Any:
        """The ``gtsam.NonlinearFactorGraph``, built when it is first asked for; None for a map without a recipe.

        Its keys are ``X(frame)`` for poses (world_from_cam), ``L(track_id)`` for landmarks, and ``K(0)`` for the lens,
        whose prior is what the calibration leaves open. The lens is held where gtsam has no calibration for it, and
        with ``map.lens_uncertainty = 0``. The noise of the reprojection factors is larger than ``noise_px``, so that
        the marginals cover errors that are not independent.
        """
        return None if self.recipe is None else self.recipe.graph

    @property
    def values(self) -> Any:
        """The ``gtsam.Values`` at the optimum of :attr:`graph`."""
        return None if self.recipe is None else self.recipe.values

    @property
    def risk(self) -> float | None:
        """Probability that the map is wrong: :attr:`model_risk`, and the rate of causes that no model has."""
        return None if self.model_risk is None else min(1.0, self.model_risk + UNMODELLED_RISK)

    @staticmethod
    def check(thing: object) -> None:
        """Refuse what is no map.

        Parameters
        ----------
        thing : object
            What the caller gave for one.

        Raises
        ------
        SlamInitError
            A run that does not initialize has no map, and a map is a part of a result.
        """
        check_type(thing, InitialMap, "the map", "result.map, of a result that is truthy")

    @property
    def depth_sigma(self) -> float:
        """Median of ``depth_sigmas``; NaN without landmarks."""
        return float(np.median(self.depth_sigmas)) if len(self.depth_sigmas) else math.nan

    @property
    def poses(self) -> Floats:
        """(K, 4, 4) ``world_from_cam`` of the keyframes as matrices."""
        return np.array([keyframe.world_from_cam.matrix() for keyframe in self.keyframes]).reshape(-1, 4, 4)

    def seen_in(self, observed: Observations) -> tuple[Ints, Ints, Floats]:
        """Find the landmarks that a frame sees.

        Parameters
        ----------
        observed : Observations
            The tracks of the frame, with bearings of the stated camera.

        Returns
        -------
        landmarks : (N,) int
            Positions in ``points``.
        features : (N,) int
            Positions in the observations.
        bearings : (N, 3) float
            Unit rays in the camera frame, by the camera of the map. Observations that this camera cannot have made are
            left out.
        """
        _, i, j = np.intersect1d(self.track_ids, observed.track_ids, return_indices=True)
        if self.focal_factor_sigma is None:
            return i, j, observed.bearings[j]
        bearings = self.camera.bearings(observed.pixels[j])
        known = np.isfinite(bearings).all(axis=1)
        return i[known], j[known], bearings[known]

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        frames = ", ".join(str(keyframe.frame) for keyframe in self.keyframes)
        landmarks = f"{len(self.points)}, {self.scene} scene, median parallax {self.median_parallax_deg:.2f} deg"
        return f"map of {len(self.keyframes)} keyframes and {len(self.points)} landmarks, {self.scene} scene", [
            ("keyframes", f"frames {frames}"),
            ("landmarks", landmarks),
            *([] if math.isnan(self.depth_sigma) else [("depths", f"+- {self.depth_sigma:.2%} (median)")]),
            ("reprojection", f"{self.reprojection_rmse_px:.2f} px (rms), noise {self.noise_px:.2f} px"),
            *([] if self.scale is None else [("scale", str(self.scale).split("\n")[0])]),
            *([] if self.gravity is None else [("gravity", str(self.gravity))]),
        ]
