"""The nouns of the pipeline: poses, frames, tracks, pairs, maps, results.

Conventions, stated once for the whole project:

* A pose named ``a_from_b`` maps coordinates of frame b to frame a: ``X_a = R X_b + t``. Names cancel when poses are
  composed: ``a_from_c = a_from_b @ b_from_c``.
* Camera frames are optical: x right, y down, z forward.
* Quaternions are Hamilton, ordered ``wxyz``, with ``w >= 0``.
* Two views obey ``u R m + t = v n`` (see :mod:`quest`) with ``R, t = cam2_from_cam1``.
* Pixel centres lie at integer coordinates. Units are suffixes: ``_px``, ``_deg``, ``_rad``, ``_s``, ``_ms``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from quest.quaternion import matrix_from_quaternion, quaternion_from_matrix
from slam_init.reasons import Gate

if TYPE_CHECKING:
    from slam_init.camera import Camera
    from slam_init.mapping import Margin

__all__ = [
    "Attempt",
    "Bools",
    "Floats",
    "Frame",
    "Image",
    "InitialMap",
    "Ints",
    "Keyframe",
    "Observations",
    "Pose",
    "Result",
    "Source",
    "Trajectory",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transformation ``X_a = R X_b + t``; name variables ``a_from_b``."""

    R: Floats
    t: Floats

    @staticmethod
    def identity() -> Pose:
        """The pose that changes nothing."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_quaternion(q_wxyz: Floats, t: Floats) -> Pose:
        """Build from a Hamilton quaternion ``wxyz`` (any norm but zero) and a translation."""
        return Pose(matrix_from_quaternion(np.asarray(q_wxyz, float)), np.asarray(t, float))

    @property
    def q_wxyz(self) -> Floats:
        """Unit Hamilton quaternion, w first, ``w >= 0``."""
        return quaternion_from_matrix(self.R)

    @property
    def centre(self) -> Floats:
        """For ``cam_from_world``: where the camera stands in the world, ``-R^T t``."""
        return -self.R.T @ self.t

    def inverse(self) -> Pose:
        """``b_from_a``."""
        return Pose(self.R.T, -self.R.T @ self.t)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, self.R @ other.t + self.t)

    def apply(self, points: Floats) -> Floats:
        """Transform points (..., 3) of frame b to frame a."""
        return points @ self.R.T + self.t


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a source.

    Attributes
    ----------
    index : int
        Absolute position in the source, from 0, whatever ``--start`` says.
    timestamp_s : float
        Time stamp of the source in seconds.
    name : str
        File name relative to the source's image folder, or ``frame-000012`` for videos.
    image : (H, W) or (H, W, 3) uint8
        Grey or BGR, as read.
    """

    index: int
    timestamp_s: float
    name: str
    image: Image

    @cached_property
    def gray(self) -> Image:
        """(H, W) uint8 luminance."""
        if self.image.ndim == 2:
            return self.image
        import cv2

        return np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Time-stamped poses ``world_from_cam``.

    Attributes
    ----------
    timestamps_s : (N,) float
        Strictly increasing.
    world_from_cam : tuple of N Pose
    """

    timestamps_s: Floats
    world_from_cam: tuple[Pose, ...]

    def at(self, timestamp_s: float, tolerance_s: float = 0.02) -> Pose | None:
        """The pose nearest in time, or None where none lies within the tolerance."""
        if len(self.timestamps_s) == 0:
            return None
        i = int(np.argmin(np.abs(self.timestamps_s - timestamp_s)))
        return self.world_from_cam[i] if abs(self.timestamps_s[i] - timestamp_s) <= tolerance_s else None


class Source(Protocol):
    """Anything that yields frames in time order: a folder, a video, a synthetic world."""

    @property
    def name(self) -> str:
        """Short name for reports."""
        ...

    @property
    def kind(self) -> str:
        """``tum``, ``euroc``, ``kitti``, ``images``, ``video`` or ``synth``."""
        ...

    @property
    def camera(self) -> Camera | None:
        """The calibration that comes with the source, if any."""
        ...

    @property
    def groundtruth(self) -> Trajectory | None:
        """The true trajectory that comes with the source, if any."""
        ...

    def __len__(self) -> int:
        """Number of frames (for a video, as its header says)."""
        ...

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Yield frames in order from absolute index ``start``."""
        ...


@dataclass(frozen=True, eq=False)
class Observations:
    """Where the tracks are seen in one frame.

    Attributes
    ----------
    frame : int
        Absolute index of the frame.
    timestamp_s : float
    name : str
        Name of the image.
    track_ids : (N,) int
        Strictly increasing, so that two frames are joined by a sorted intersection.
    pixels : (N, 2) float
        As measured in the raw image.
    bearings : (N, 3) float
        Unit rays in the camera frame (undistorted once, here).
    colors : (N, 3) uint8
        RGB of the image there.
    """

    frame: int
    timestamp_s: float
    name: str
    track_ids: Ints
    pixels: Floats
    bearings: Floats
    colors: Image = field(default_factory=lambda: np.zeros((0, 3), np.uint8))

    def __len__(self) -> int:
        return len(self.track_ids)


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt to initialize, and what became of it.

    Attributes
    ----------
    frames : tuple of int
        Absolute indices of the pair (reference, current), then of further views that had a vote.
    verdict : str
        ``accepted`` or a reason of :data:`slam_init.reasons.REASONS`.
    evidence : dict
        Name -> number (or short text) that led to the verdict: each gate's value and threshold.
    advice : str
        What would help, in a few words for a person: that of the gate that failed; empty when accepted.
    pixels1, pixels2 : (N, 2) float
        The matches of the pair, raw pixels.
    inliers : (N,) bool
        Which of them the best model explains.
    gates : tuple of Gate
        The conditions that were looked at, with values and thresholds, up to the stage that failed.
    progress : float
        How far the pair came, 0 to 1: see :func:`slam_init.online.progress`.
    lacking : float
        By which factor the gates were missed that go with the inverse of the parallax: so much longer the way has to
        be. 1 where that is not what failed.
    """

    frames: tuple[int, ...]
    verdict: str
    evidence: dict[str, float | int | str]
    advice: str = ""
    pixels1: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    pixels2: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    inliers: Bools = field(default_factory=lambda: np.zeros(0, bool))
    gates: tuple[Gate, ...] = ()
    progress: float = 0.0
    lacking: float = 1.0


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A view of the initial map."""

    frame: int
    timestamp_s: float
    name: str
    world_from_cam: Pose


@dataclass(frozen=True, eq=False)
class InitialMap:
    """The initial map: keyframes in time order, landmarks, and which keyframe saw which landmark where.

    The world frame is the first keyframe's camera frame; the unit of length is the median depth of the landmarks in
    it.

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
        Raw pixels.
    colors : (L, 3) uint8
        RGB of each landmark, sampled from the images.
    pose_covariances : (K, 6, 6) float
        Marginal covariances of ``world_from_cam`` in gtsam's tangent order (rotation, translation) in the camera
        frame, in the gauge that ``gauge`` names, scaled by the noise estimated from the residuals.
    gauge : str
        What was held fixed.
    graph, values
        ``gtsam.NonlinearFactorGraph`` and ``gtsam.Values``: keys ``X(frame)`` for poses (world_from_cam),
        ``L(track_id)`` for landmarks and, where the focal length was adjusted, ``K(0)`` for the calibration.
    points_before : (L, 3) float
        The landmarks as triangulated, before bundle adjustment, in the same frame and scale.
    keyframes_before : tuple of K Pose
        world_from_cam before bundle adjustment.
    bundle_errors : tuple of float
        Bundle adjustment: root mean square residual in pixels at the start and after each iteration; while the kernel
        is robust, of what the kernel leaves of the residuals.
    reprojection_rmse_px : float
        Root mean square over observations of the 2-D reprojection error.
    median_parallax_deg : float
        Median over landmarks of the largest angle between two of its rays.
    noise_px : float
        Standard deviation of a coordinate as estimated from the residuals.
    scene : str
        ``general`` or ``planar``.
    camera : Camera
        With which the landmarks project to the observations: the stated one, or the same with the adjusted focal
        length. The bearings of :class:`Observations` stay those of the stated camera: :meth:`seen_in` has the others.
    focal_factor : float
        The adjusted focal length over the stated one; 1 where it was held.
    focal_factor_sigma : float or None
        Its standard deviation, by the noise of the tracks and the prior; None where it was held.
    """

    keyframes: tuple[Keyframe, ...]
    points: Floats
    track_ids: Ints
    observation_keyframes: Ints
    observation_landmarks: Ints
    observation_pixels: Floats
    colors: NDArray[np.uint8]
    pose_covariances: Floats
    gauge: str
    graph: Any
    values: Any
    points_before: Floats
    keyframes_before: tuple[Pose, ...]
    bundle_errors: tuple[float, ...]
    reprojection_rmse_px: float
    median_parallax_deg: float
    noise_px: float
    scene: str
    camera: Camera
    focal_factor: float = 1.0
    focal_factor_sigma: float | None = None

    def seen_in(self, observed: Observations) -> tuple[Ints, Ints, Floats]:
        """The landmarks that a frame sees, and where.

        Returns
        -------
        landmarks : (N,) int
            Positions in ``points``.
        features : (N,) int
            Positions in the observations.
        bearings : (N, 3) float
            Unit rays in the camera frame, by the camera of the map; what it cannot have seen is left out.
        """
        _, i, j = np.intersect1d(self.track_ids, observed.track_ids, return_indices=True)
        if self.focal_factor_sigma is None:
            return i, j, observed.bearings[j]
        bearings = self.camera.bearings(observed.pixels[j])
        known = np.isfinite(bearings).all(axis=1)
        return i[known], j[known], bearings[known]


@dataclass(frozen=True, eq=False)
class Result:
    """What a run ends with. Truthy when initialized.

    Attributes
    ----------
    map : InitialMap or None
    reason : str or None
        None when initialized, else one of :data:`slam_init.reasons.REASONS`.
    frames_read : int
    frames_to_init : int or None
        Number of frames consumed, counted from the first one fed, when the map was accepted.
    attempts : tuple of Attempt
        The last :data:`slam_init.handover.ATTEMPTS_KEPT`.
    timing_ms : dict
        Stage -> {"median", "p95", "total", "calls"} in milliseconds.
    notes : tuple of str
        What the user should know, e.g. that the camera was guessed.
    advice : str
        What would help, for the reason; empty when initialized.
    hypotheses : tuple of InitialMap
        The maps one of which is true: ``(map,)`` when initialized; the two that the views could not decide between,
        the better one first, while that is so; else empty.
    margin : Margin or None
        By how much the first hypothesis is better than its rival, of the last vote between two maps; None where there
        was no rival.
    """

    map: InitialMap | None
    reason: str | None
    frames_read: int
    frames_to_init: int | None
    attempts: tuple[Attempt, ...]
    timing_ms: dict[str, dict[str, float]]
    notes: tuple[str, ...] = ()
    advice: str = ""
    hypotheses: tuple[InitialMap, ...] = ()
    margin: Margin | None = None

    def __bool__(self) -> bool:
        return self.map is not None

    @property
    def status(self) -> str:
        """``initialized`` or ``not_initialized``."""
        return "initialized" if self.map is not None else "not_initialized"
