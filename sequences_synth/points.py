"""Tracks without images: points of a known scene seen by a moving camera, thousands of sequences per minute.

The scenes have the names of the rendered ones, and depth, planes and motion of the same kind, drawn from a seed. Tracks
have Gaussian noise. Some tracks are outliers, and on request some lie on bodies that move on their own. On request the
tracks of a view also have a smooth error in common (:mod:`sequences_synth.tracking_error`). Poses are
``world_from_cam``. The world frame is the pose at which the camera would start without the tremor of the hand. The
length of the path is given relative to the median depth of the scene ::

    sequence = make_points("wall", seed=3, options=PointOptions(noise_px=1.0))
    track_ids, pixels = sequence.observe(5)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sequences_synth.point_scenes import LAYOUTS, Layout
from sequences_synth.sequence import PinholeCamera
from sequences_synth.tracking_error import TrackingError
from sequences_synth.trajectory import rotation_from_vector

__all__ = ["POINT_SCENES", "SCENES_WITHOUT_TRANSLATION", "PointOptions", "PointSequence", "make_points"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Names of the scenes.
POINT_SCENES: tuple[str, ...] = tuple(LAYOUTS)
#: Scenes in which the camera never translates.
SCENES_WITHOUT_TRANSLATION: tuple[str, ...] = ("rotation", "static")

# A horizontal field of view of 70 degrees at 640x480: an ordinary wide lens.
_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 458.0
# A point nearer than this share of the median depth is not visible: it would be out of focus.
_NEAREST = 0.05
# Time between two views.
_STEP_S = 0.1
# Number of tracks of a sequence over the number of visible points in a view: points leave the view and others enter.
_TRACKS_BY_VISIBLE = 1.15
# What a track is: a point of the scene at rest, a point on a moving body, or an outlier.
_STATIC, _MOVING, _OUTLIER = 0, 1, 2


@dataclass(frozen=True)
class PointOptions:
    """Options of a sequence; the same for every scene.

    Attributes
    ----------
    views : int
        Number of frames, 0.1 s apart.
    points : int
        Approximate number of tracks in a view.
    noise_px : float
        Standard deviation of one coordinate of a pixel.
    outliers : float
        Share of the tracks that are outliers: in each view at a random place in the image.
    moving : float
        Share of the tracks on two bodies that move on their own.
    baseline : float
        Distance of the camera from first to last view over the median depth. Ignored where the camera does not
        translate.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    field_px : float
        Root mean square of one coordinate of a smooth error field that the tracks of a view have in common, over the
        image. The field of each view is independent of the others. Outliers do not have it.
    drift_px : float
        The same for a smooth field that performs a random walk over the views: 0 in the first view, and ``drift_px`` in
        the last one.

    Raises
    ------
    ValueError
        If an option is out of range; the message names the option.
    """

    views: int = 12
    points: int = 300
    noise_px: float = 0.7
    outliers: float = 0.1
    moving: float = 0.0
    baseline: float = 0.15
    focal_error: float = 0.0
    field_px: float = 0.0
    drift_px: float = 0.0

    def __post_init__(self) -> None:
        limits: dict[str, tuple[float, float]] = {
            "views": (2, 10_000), "points": (1, 100_000), "noise_px": (0, 100), "outliers": (0, 1), "moving": (0, 1),
            "baseline": (0, 10), "focal_error": (-0.9, 10), "field_px": (0, 100), "drift_px": (0, 100),
        }  # fmt: skip
        for name in (f.name for f in fields(self)):
            value, (low, high) = getattr(self, name), limits[name]
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} is {value!r}: it must lie between {low} and {high}")
        if self.outliers + self.moving > 1:
            raise ValueError(f"outliers and moving are {self.outliers} and {self.moving}: together at most 1")


@dataclass(frozen=True, eq=False)
class PointSequence:
    """A sequence of tracks with exact truth.

    Attributes
    ----------
    name : str
    seed : int
    options : PointOptions
    camera : PinholeCamera
        The stated camera; its focal length is wrong where ``options.focal_error`` is not 0.
    true_camera : PinholeCamera
        The camera by which the points were projected.
    poses : (V, 4, 4) float
        world_from_cam.
    timestamps_s : (V,) float
    points : (M, 3) float
        In the world frame, at the first view. Those on moving bodies change their place later.
    is_outlier : (M,) bool
        Tracks that are outliers.
    is_moving : (M,) bool
        Tracks on moving bodies.
    pixels : (V, M, 2) float
        Measured pixels, with noise and correlated error.
    visible : (V, M) bool
        Whether a view sees a track.
    tracking_error : TrackingError
        The correlated error that ``pixels`` contain, except those of outliers.
    """

    name: str
    seed: int
    options: PointOptions
    camera: PinholeCamera
    true_camera: PinholeCamera
    poses: Floats
    timestamps_s: Floats
    points: Floats
    is_outlier: Bools
    is_moving: Bools
    pixels: Floats
    visible: Bools
    tracking_error: TrackingError

    def __len__(self) -> int:
        return len(self.poses)

    def observe(self, index: int) -> tuple[Ints, Floats]:
        """Read the tracks that one view sees.

        Parameters
        ----------
        index : int
            Position of the view, from 0.

        Returns
        -------
        track_ids : (N,) int
            Ascending.
        pixels : (N, 2) float
            Measured pixels.
        """
        ids = np.flatnonzero(self.visible[index])
        return ids.astype(np.int64), self.pixels[index, ids]

    def depths(self, index: int) -> Floats:
        """Compute the true depth of each track in one view.

        Parameters
        ----------
        index : int
            Position of the view, from 0.

        Returns
        -------
        (M,) float
            Depth along the optical axis; NaN for outliers and for tracks on moving bodies.
        """
        cam_from_world = np.linalg.inv(self.poses[index])
        z = self.points @ cam_from_world[2, :3] + cam_from_world[2, 3]
        return np.asarray(np.where(self.is_outlier | self.is_moving, np.nan, z))


def make_points(name: str, seed: int = 0, options: PointOptions | None = None) -> PointSequence:
    """Make a sequence of tracks.

    Parameters
    ----------
    name : str
        One of :data:`POINT_SCENES`.
    seed : int
        Changes geometry, path, noise and outliers; not negative.
    options : PointOptions, optional

    Returns
    -------
    PointSequence

    Raises
    ------
    ValueError
        If the scene is unknown (the message lists the known ones), or if the seed is negative.
    """
    if name not in LAYOUTS:
        raise ValueError(f"unknown scene {name!r}: use one of {', '.join(POINT_SCENES)}")
    if seed < 0:
        raise ValueError(f"seed is {seed}: it must not be negative")
    options = options or PointOptions()
    rng = np.random.default_rng((seed, *name.encode()))
    true_camera = PinholeCamera(_WIDTH, _HEIGHT, _FOCAL_PX, _FOCAL_PX, (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2)
    layout = LAYOUTS[name](rng)
    scale, poses = _poses(layout, options, rng)
    points = _points(layout, poses, true_camera, options, rng)
    kinds = _kinds(points, options, rng)
    # The correlated error has its own generator, so that its options change neither the scene nor the noise.
    error_rng = np.random.default_rng((seed, *b"tracking error ", *name.encode()))
    size = true_camera.width, true_camera.height
    error = TrackingError.draw(error_rng, options.views, *size, options.field_px, options.drift_px)
    pixels, visible = _project(points, kinds, poses, scale, true_camera, error, options, rng)
    stated = _FOCAL_PX * (1 + options.focal_error)
    return PointSequence(
        name=name,
        seed=seed,
        options=options,
        camera=replace(true_camera, fx=stated, fy=stated),
        true_camera=true_camera,
        poses=poses,
        timestamps_s=_STEP_S * np.arange(options.views, dtype=float),
        points=points,
        is_outlier=kinds == _OUTLIER,
        is_moving=kinds == _MOVING,
        pixels=pixels,
        visible=visible,
        tracking_error=error,
    )


def _poses(layout: Layout, options: PointOptions, rng: np.random.Generator) -> tuple[float, Floats]:
    """Length of the path, and world_from_cam (V, 4, 4)."""
    rays = _rays(rng.uniform((0, 0), (_WIDTH, _HEIGHT), (500, 2)), _FOCAL_PX)
    depths = layout.depth(np.zeros((500, 3)), rays)
    scale = options.baseline * float(np.median(depths[depths > 0]))
    phases, sizes = rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform(0.3, 1.0, (2, 3))
    poses = np.tile(np.eye(4), (options.views, 1, 1))
    for view, pose in enumerate(poses):
        s = view / (options.views - 1)
        waves = sizes * np.sin(phases + 2 * np.pi * s * np.array([[1.0, 1.3, 0.8], [1.1, 0.7, 1.4]]))
        # The tremor of a steady hand: a third of a degree, and a hundredth of the path length.
        shake, offset = (np.radians(0.3) * waves[0], 0.01 * waves[1]) if layout.tremor else (0.0, 0.0)
        position = layout.position(s)
        pose[:3, :3] = rotation_from_vector(layout.rotation(s)) @ rotation_from_vector(np.zeros(3) + shake)
        # A camera that does not translate must not be translated by the tremor.
        pose[:3, 3] = scale * (position + offset * bool(np.any(layout.position(1.0))) * (s > 0) * np.any(position))
    return scale, poses


def _points(
    layout: Layout, poses: Floats, camera: PinholeCamera, options: PointOptions, rng: np.random.Generator
) -> Floats:
    """Points (M, 3) that the views see, in the world."""
    found = np.zeros((0, 3))
    wanted = max(1, round(_TRACKS_BY_VISIBLE * options.points))
    while len(found) < wanted:
        count = 2 * wanted
        view = rng.integers(0, len(poses), count)
        rays = _rays(rng.uniform((0, 0), (camera.width, camera.height), (count, 2)), camera.fx)
        rays = np.einsum("nij,nj->ni", poses[view, :3, :3], rays)
        origins = poses[view, :3, 3]
        depth = layout.depth(origins, rays)
        ends = origins + depth[:, None] * rays
        found = np.concatenate([found, ends[depth > 0]])
    return found[:wanted]


def _kinds(points: Floats, options: PointOptions, rng: np.random.Generator) -> Ints:
    """(M,) kind of each track. Moving bodies are compact in the first view; outliers are random tracks."""
    count = len(points)
    kinds = np.full(count, _STATIC, np.int64)
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    for body in range(2):
        size = round(options.moving * count * (body + 1) / 2) - int(np.sum(kinds == _MOVING))
        centre = direction[rng.integers(count)]
        nearest = np.argsort(-direction @ centre + 10.0 * (kinds == _MOVING), kind="stable")
        kinds[nearest[:size]] = _MOVING
    rest = rng.permutation(np.flatnonzero(kinds == _STATIC))
    kinds[rest[: round(options.outliers * count)]] = _OUTLIER
    return kinds


def _project(
    points: Floats,
    kinds: Ints,
    poses: Floats,
    scale: float,
    camera: PinholeCamera,
    error: TrackingError,
    options: PointOptions,
    rng: np.random.Generator,
) -> tuple[Floats, Bools]:
    """Measured pixels (V, M, 2), and which tracks each view sees (V, M)."""
    size = np.array([camera.width, camera.height], float)
    # Each body moves about as fast as the camera, in its own direction. Where the camera does not translate, the
    # speed is that of the default baseline.
    speed = scale if scale > 0 else PointOptions.baseline * float(np.median(np.linalg.norm(points, axis=1)))
    moving = np.flatnonzero(kinds == _MOVING)
    body = np.arange(len(moving)) < len(moving) // 2
    shift = rng.normal(size=(2, 3))
    shift *= speed * rng.uniform(0.5, 1.5, (2, 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    pixels = np.empty((len(poses), len(points), 2))
    visible = np.empty(pixels.shape[:2], bool)
    for view, pose in enumerate(poses):
        X = points.copy()
        X[moving] += view / (len(poses) - 1) * shift[body.astype(int)]
        X = (X - pose[:3, 3]) @ pose[:3, :3]
        ahead = X[:, 2] > _NEAREST * np.median(np.abs(X[:, 2]))
        z = np.where(ahead, X[:, 2], 1.0)[:, None]
        true = camera.fx * X[:, :2] / z + [camera.cx, camera.cy]
        measured = true + options.noise_px * rng.normal(size=true.shape) + error.at(view, true)
        anywhere = rng.uniform(0, size - 1, measured.shape)
        pixels[view] = np.where((kinds == _OUTLIER)[:, None], anywhere, measured)
        inside = ((pixels[view] >= 0) & (pixels[view] <= size - 1)).all(axis=1)
        visible[view] = ahead & inside & (true >= 0).all(axis=1) & (true <= size - 1).all(axis=1)
    return pixels, visible


def _rays(pixels: Floats, focal_px: float) -> Floats:
    centre = np.array([(_WIDTH - 1) / 2, (_HEIGHT - 1) / 2])
    return np.column_stack([(pixels - centre) / focal_px, np.ones(len(pixels))])
