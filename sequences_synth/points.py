"""Tracks without images: points of a known scene seen by a moving camera, thousands of sequences a minute.

The scenes bear the names of the rendered ones and have their geometry: depth, planes and motion of the same kind, drawn
from a seed. Tracks have Gaussian noise; some are wrong matches, and on request some lie on bodies that move on their
own. Poses are ``world_from_cam``; the world is where the camera would start without the tremor of the hand; the length
of its way is given relative to the median depth of the scene ::

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
from sequences_synth.trajectory import rotation_from_vector

__all__ = ["POINT_SCENES", "STILL_SCENES", "PointOptions", "PointSequence", "make_points"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

POINT_SCENES: tuple[str, ...] = tuple(LAYOUTS)
#: Where the camera never translates.
STILL_SCENES: tuple[str, ...] = ("rotation", "static")

# 70 degrees across at 640x480: an ordinary wide lens.
_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 458.0
# Nothing nearer than this share of the median depth is seen: it would be out of focus.
_NEAREST = 0.05
# Views are this far apart in time.
_STEP_S = 0.1
# Points that leave the view are replaced by others that enter: about this many tracks for each one in a view.
_TRACKS_BY_VISIBLE = 1.15
_STATIC, _MOVING, _WRONG = 0, 1, 2


@dataclass(frozen=True)
class PointOptions:
    """What is varied; the same for every scene.

    Attributes
    ----------
    views : int
        Number of frames, 0.1 s apart.
    points : int
        Tracks in a view, about.
    noise_px : float
        Standard deviation of a coordinate.
    outliers : float
        Share of the tracks that are wrong matches: in each view somewhere in the image.
    moving : float
        Share of the tracks on two bodies that move on their own.
    baseline : float
        Way of the camera from first to last view over the median depth. Without meaning where the camera stays.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    """

    views: int = 12
    points: int = 300
    noise_px: float = 0.7
    outliers: float = 0.1
    moving: float = 0.0
    baseline: float = 0.15
    focal_error: float = 0.0

    def __post_init__(self) -> None:
        limits: dict[str, tuple[float, float]] = {
            "views": (2, 10_000), "points": (1, 100_000), "noise_px": (0, 100), "outliers": (0, 1), "moving": (0, 1),
            "baseline": (0, 10), "focal_error": (-0.9, 10),
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
        As stated to the user: wrong where ``options.focal_error`` is not 0.
    true_camera : PinholeCamera
        What the pixels were made with.
    poses : (V, 4, 4) float
        world_from_cam.
    timestamps_s : (V,) float
    points : (M, 3) float
        In the world, at the first view; those on moving bodies are elsewhere later.
    wrong, moving : (M,) bool
        Tracks that are wrong matches, and that lie on moving bodies.
    pixels : (V, M, 2) float
        As measured.
    visible : (V, M) bool
    """

    name: str
    seed: int
    options: PointOptions
    camera: PinholeCamera
    true_camera: PinholeCamera
    poses: Floats
    timestamps_s: Floats
    points: Floats
    wrong: Bools
    moving: Bools
    pixels: Floats
    visible: Bools

    def __len__(self) -> int:
        return len(self.poses)

    def observe(self, index: int) -> tuple[Ints, Floats]:
        """Track ids (N,), ascending, and their pixels (N, 2) in one view."""
        ids = np.flatnonzero(self.visible[index])
        return ids.astype(np.int64), self.pixels[index, ids]

    def depths(self, index: int) -> Floats:
        """(M,) true depth of each track along the optical axis of a view; NaN for what is no point at rest."""
        cam_from_world = np.linalg.inv(self.poses[index])
        z = self.points @ cam_from_world[2, :3] + cam_from_world[2, 3]
        return np.asarray(np.where(self.wrong | self.moving, np.nan, z))


def make_points(name: str, seed: int = 0, options: PointOptions | None = None) -> PointSequence:
    """Make a sequence of tracks.

    Parameters
    ----------
    name : str
        One of :data:`POINT_SCENES`.
    seed : int
        Changes geometry, path, noise and outliers; not negative.
    options : PointOptions, optional

    Raises
    ------
    ValueError
        Where the scene is unknown, naming those there are, or the seed is negative.
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
    pixels, visible = _project(points, kinds, poses, scale, true_camera, options, rng)
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
        wrong=kinds == _WRONG,
        moving=kinds == _MOVING,
        pixels=pixels,
        visible=visible,
    )


def _poses(layout: Layout, options: PointOptions, rng: np.random.Generator) -> tuple[float, Floats]:
    """Length of the way, and world_from_cam (V, 4, 4)."""
    rays = _rays(rng.uniform((0, 0), (_WIDTH, _HEIGHT), (500, 2)), _FOCAL_PX)
    depths = layout.depth(np.zeros((500, 3)), rays)
    scale = options.baseline * float(np.median(depths[depths > 0]))
    phases, sizes = rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform(0.3, 1.0, (2, 3))
    poses = np.tile(np.eye(4), (options.views, 1, 1))
    for view, pose in enumerate(poses):
        s = view / (options.views - 1)
        waves = sizes * np.sin(phases + 2 * np.pi * s * np.array([[1.0, 1.3, 0.8], [1.1, 0.7, 1.4]]))
        # A third of a degree and a hundredth of the way: a steady hand.
        shake, offset = (np.radians(0.3) * waves[0], 0.01 * waves[1]) if layout.tremor else (0.0, 0.0)
        way = layout.way(s)
        pose[:3, :3] = rotation_from_vector(layout.turn(s)) @ rotation_from_vector(np.zeros(3) + shake)
        # Where the camera does not go anywhere the tremor must not take it there.
        pose[:3, 3] = scale * (way + offset * bool(np.any(layout.way(1.0))) * (s > 0) * np.any(way))
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
    """(M,) what each track is: bodies are compact in the first view, wrong matches are anywhere."""
    count = len(points)
    kinds = np.full(count, _STATIC, np.int64)
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    for body in range(2):
        size = round(options.moving * count * (body + 1) / 2) - int(np.sum(kinds == _MOVING))
        centre = direction[rng.integers(count)]
        nearest = np.argsort(-direction @ centre + 10.0 * (kinds == _MOVING), kind="stable")
        kinds[nearest[:size]] = _MOVING
    rest = rng.permutation(np.flatnonzero(kinds == _STATIC))
    kinds[rest[: round(options.outliers * count)]] = _WRONG
    return kinds


def _project(
    points: Floats,
    kinds: Ints,
    poses: Floats,
    scale: float,
    camera: PinholeCamera,
    options: PointOptions,
    rng: np.random.Generator,
) -> tuple[Floats, Bools]:
    """Measured pixels (V, M, 2), and which tracks each view sees (V, M)."""
    size = np.array([camera.width, camera.height], float)
    # Bodies go as fast as the camera (at the default baseline where it goes nowhere), each its own way.
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
        measured = true + options.noise_px * rng.normal(size=true.shape)
        anywhere = rng.uniform(0, size - 1, measured.shape)
        pixels[view] = np.where((kinds == _WRONG)[:, None], anywhere, measured)
        inside = ((pixels[view] >= 0) & (pixels[view] <= size - 1)).all(axis=1)
        visible[view] = ahead & inside & (true >= 0).all(axis=1) & (true <= size - 1).all(axis=1)
    return pixels, visible


def _rays(pixels: Floats, focal_px: float) -> Floats:
    centre = np.array([(_WIDTH - 1) / 2, (_HEIGHT - 1) / 2])
    return np.column_stack([(pixels - centre) / focal_px, np.ones(len(pixels))])
