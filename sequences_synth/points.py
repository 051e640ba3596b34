"""Tracks without images: points of a known scene seen by a moving camera, thousands of sequences per minute.

The scenes have the names of the rendered ones, and depth, planes and motion of the same kind, drawn from a seed. Tracks
have Gaussian noise. Some tracks are outliers, and on request some lie on bodies that move on their own. On request the
tracks of a view also have a smooth error in common (:mod:`sequences_synth.tracking_error`), and the camera has a
rolling shutter (:mod:`sequences_synth.shutter`), a long exposure, wrong calibration, or electronic stabilization
(:mod:`sequences_synth.stabilizer`). Frames may be dropped or repeated, and a cut may lead to another scene. Poses are
``world_from_cam`` of the middle row. The world frame is the pose at which the camera would start without the tremor of
the hand; in the scenes ``handheld`` and ``handheld-wall`` it is the pose about which the hand turns the camera. The
length of the path is given relative to the median depth of the scene ::

    sequence = make_points("wall", seed=3, options=PointOptions(noise_px=1.0))
    track_ids, pixels = sequence.observe(5)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sequences_synth.camera import PinholeCamera, stated_camera
from sequences_synth.hand_motion import Handling
from sequences_synth.point_path import Bodies, PointPath
from sequences_synth.point_scenes import HAND_LAYOUTS, LAYOUTS, Layout
from sequences_synth.point_shot import Shot
from sequences_synth.schedule import Schedule
from sequences_synth.shutter import READOUT_DIRECTIONS, Shutter
from sequences_synth.tracking_error import TrackingError

__all__ = ["POINT_SCENES", "SCENES_WITHOUT_TRANSLATION", "PointOptions", "PointSequence", "make_points"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Names of the scenes.
POINT_SCENES: tuple[str, ...] = (*LAYOUTS, *HAND_LAYOUTS)
#: Scenes in which the camera never translates. In the scenes ``handheld`` and ``handheld-wall`` the camera does not
#: translate either if the option ``speed`` is 0.
SCENES_WITHOUT_TRANSLATION: tuple[str, ...] = ("rotation", "static", "pan")

# A horizontal field of view of 70 degrees at 640x480: an ordinary wide lens.
_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 458.0
# Number of tracks of a sequence over the number of visible points in a view: points leave the view and others enter.
_TRACKS_BY_VISIBLE = 1.15
# The points of a hand-held scene are spread evenly over what this many views see. The other views lie between them.
_SPREAD_VIEWS = 60
# Standard deviation of a track along the blur of a long exposure, over the length of the blur. In rendered frames of
# the scenes `handheld` and `pan` (80 deg/s, exposures of 10 to 30 ms) Lucas-Kanade tracks err along the blur by
# 0.015 of its length from one frame to the next. Such errors add up: to 0.1 over 45 frames. The error here is
# independent in each view, and has this size from the first view on; a tracker has less on its first frames.
_BLUR = 0.1
# What a track is: a point of the scene at rest, a point on a moving body, or an outlier.
_STATIC, _MOVING, _OUTLIER = 0, 1, 2


@dataclass(frozen=True)
class PointOptions:
    """Options of a sequence; the same for every scene.

    Attributes
    ----------
    views : int
        Number of frames.
    points : int
        Approximate number of tracks in a view.
    noise_px : float
        Standard deviation of one coordinate of a pixel.
    outliers : float
        Share of the tracks that are outliers: in each view at a random place in the image.
    moving : float
        Share of the tracks on bodies that move on their own.
    baseline : float
        Distance of the camera from first to last view over the median depth. Where the camera does not translate, and
        in ``handheld`` and ``handheld-wall``, it is only the scale of the motion of bodies.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    field_px : float
        Root mean square of one coordinate of a smooth error field that the tracks of a view have in common, over the
        image. The field of each view is independent of the others. Outliers do not have it.
    drift_px : float
        The same for a smooth field that performs a random walk over the views: 0 in the first view, and ``drift_px`` in
        the last one.
    fps : float
        Frames per second. In the scenes ``handheld``, ``handheld-wall`` and ``pan`` it decides how far the camera turns
        from view to view. The path of the other scenes does not depend on it.
    readout_ms : float
        Readout time of the rolling shutter, at most a frame interval; 0 for a global shutter. See
        :mod:`sequences_synth.shutter`.
    readout_direction : str
        Order in which rows or columns are read: ``down``, ``up``, ``right`` or ``left``.
    exposure_ms : float
        Exposure time, at most a frame interval. The standard deviation of a track along its motion in the image is
        ``hypot(noise_px, 0.1 * motion during the exposure)``; across its motion it is ``noise_px``.
    turning_deg_s : float
        Root mean square of the angular speed in the scenes ``handheld`` and ``handheld-wall``, and speed of the scene
        ``pan``. The other scenes ignore it.
    speed : float
        Speed of the translation in the scenes ``handheld`` and ``handheld-wall``, median depths per second. The other
        scenes ignore it.
    bodies : int
        Number of moving bodies among which the moving tracks are divided.
    body_turn_deg_s : float
        Angular speed of each body about its own centre; the axes are drawn.
    principal_error : float
        Error of the stated principal point: horizontally over the width, vertically over the height. The signs are
        drawn.
    k1 : float
        Coefficient of radial distortion of the true camera, which the stated camera lacks.
    stabilized : bool
        Whether each frame is warped to a smoothed path, see :mod:`sequences_synth.stabilizer`. The true poses are then
        those of the virtual camera.
    dropped : float
        Share of the frames that are missing. The frames that are left are ``views``, and their time stamps jump.
    repeated : float
        Share of the frames that repeat the frame before, with a new time stamp. The true pose of such a frame is that
        of the frame that it repeats.
    cut : int
        Position of the view at which another scene of the same kind begins, at least 2; 0 for none. All tracks are
        then new. The poses of the second scene have the world frame of the second scene: they have no relation to those
        before.

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
    fps: float = 10.0
    readout_ms: float = 0.0
    readout_direction: str = "down"
    exposure_ms: float = 0.0
    turning_deg_s: float = 60.0
    speed: float = 0.0
    bodies: int = 2
    body_turn_deg_s: float = 0.0
    principal_error: float = 0.0
    k1: float = 0.0
    stabilized: bool = False
    dropped: float = 0.0
    repeated: float = 0.0
    cut: int = 0

    def __post_init__(self) -> None:
        # Beyond the limits of k1, the lens would not be invertible within the image.
        limits: dict[str, tuple[float, float]] = {
            "views": (2, 10_000), "points": (1, 100_000), "noise_px": (0, 100), "outliers": (0, 1), "moving": (0, 1),
            "baseline": (0, 10), "focal_error": (-0.9, 10), "field_px": (0, 100), "drift_px": (0, 100),
            "fps": (1e-3, 1e4), "readout_ms": (0, 1e6), "exposure_ms": (0, 1e6), "turning_deg_s": (0, 1000),
            "speed": (0, 100), "bodies": (1, 100), "body_turn_deg_s": (0, 1000), "principal_error": (0, 0.5),
            "k1": (-0.2, 1), "stabilized": (0, 1), "dropped": (0, 0.9), "repeated": (0, 0.9), "cut": (0, 10_000),
        }  # fmt: skip
        for name in (f.name for f in fields(self) if f.name in limits):
            value, (low, high) = getattr(self, name), limits[name]
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} is {value!r}: it must lie between {low} and {high}")
        if self.outliers + self.moving > 1:
            raise ValueError(f"outliers and moving are {self.outliers} and {self.moving}: together at most 1")
        if self.readout_direction not in READOUT_DIRECTIONS:
            known = ", ".join(READOUT_DIRECTIONS)
            raise ValueError(f"readout_direction is {self.readout_direction!r}: use one of {known}")
        for name, value in (("readout_ms", self.readout_ms), ("exposure_ms", self.exposure_ms)):
            if value > 1000 / self.fps:
                raise ValueError(f"{name} is {value}: it must not exceed the frame interval, {1000 / self.fps:g} ms")
        if self.cut and not 2 <= self.cut <= self.views - 2:
            raise ValueError(f"cut is {self.cut}: each scene needs 2 of the {self.views} views")


@dataclass(frozen=True, eq=False)
class PointSequence:
    """A sequence of tracks with exact truth.

    Attributes
    ----------
    name : str
    seed : int
    options : PointOptions
    camera : PinholeCamera
        The stated camera, which has the errors of the options and no distortion.
    true_camera : PinholeCamera
        The camera by which the points were projected.
    poses : (V, 4, 4) float
        world_from_cam of the middle row. After a cut the world is another one.
    timestamps_s : (V,) float
        Time of the middle row.
    points : (M, 3) float
        In the world frame of their scene, at its first view. Those on moving bodies change their place later.
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
    body_of_track : (M,) int
        Number of the body of a moving track, -1 for other tracks.
    scene_of_track : (M,) int
        0 for tracks before the cut, 1 for tracks after it.
    schedule : Schedule
        Dropped and repeated frames, and the cut.
    shots : tuple of Shot
        The true camera, path, shutter and bodies of each scene.
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
    body_of_track: Ints
    scene_of_track: Ints
    schedule: Schedule
    shots: tuple[Shot, ...]

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
            Depth along the optical axis; NaN for outliers, for tracks on moving bodies and for those of another scene.
        """
        cam_from_world = np.linalg.inv(self.poses[index])
        z = self.points @ cam_from_world[2, :3] + cam_from_world[2, 3]
        elsewhere = self.scene_of_track != self._scene(index)
        return np.asarray(np.where(self.is_outlier | self.is_moving | elsewhere, np.nan, z))

    def pixel_poses(self, index: int, pixels: Floats) -> Floats:
        """Compute the poses that the camera had when it exposed pixels of one view.

        Parameters
        ----------
        index : int
            Position of the view, from 0.
        pixels : (N, 2) float
            True pixels.

        Returns
        -------
        (N, 4, 4) float
            Poses world_from_cam, of the virtual camera in a stabilized view. With a global shutter all are the pose of
            the view.
        """
        scene = self._scene(index)
        shown, first = (self.schedule.ticks[k] for k in (self.schedule.content[index], scene * self.schedule.cut))
        return self.shots[scene].pixel_poses(int(shown - first), pixels)

    def _scene(self, index: int) -> int:
        return int(0 < self.schedule.cut <= range(len(self))[index])


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
    if name not in POINT_SCENES:
        raise ValueError(f"unknown scene {name!r}: use one of {', '.join(POINT_SCENES)}")
    if seed < 0:
        raise ValueError(f"seed is {seed}: it must not be negative")
    options = options or PointOptions()
    centre = (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2
    true_camera = PinholeCamera(_WIDTH, _HEIGHT, _FOCAL_PX, _FOCAL_PX, *centre, k1=options.k1)
    error = TrackingError.draw(
        _stream(seed, b"tracking error ", name), options.views, _WIDTH, _HEIGHT, options.field_px, options.drift_px
    )
    schedule = Schedule.draw(
        _stream(seed, b"schedule ", name), options.views, options.dropped, options.repeated, options.cut
    )
    scenes = []
    for number, frames in enumerate(schedule.scenes):
        rng, body_rng, blur_rng = (
            _stream(seed, number * b"after the cut " + purpose, name) for purpose in (b"", b"bodies ", b"blur ")
        )
        ticks = schedule.ticks[frames] - schedule.ticks[frames.start]
        shot, kinds = _film(name, true_camera, ticks, options, rng, body_rng)
        pixels, visible = _measure(shot, kinds, ticks, frames.start, error, options, rng, blur_rng)
        scenes.append(_Scene(shot, kinds, np.stack([shot.pose(int(tick)) for tick in ticks]), pixels, visible))
    counts = [len(scene.kinds) for scene in scenes]
    kinds, content = np.concatenate([scene.kinds for scene in scenes]), schedule.content
    return PointSequence(
        name=name,
        seed=seed,
        options=options,
        camera=stated_camera(
            true_camera, options.focal_error, options.principal_error, _stream(seed, b"principal point ", name)
        ),
        true_camera=true_camera,
        poses=np.concatenate([scene.poses for scene in scenes])[content],
        timestamps_s=np.asarray(1 / options.fps * schedule.ticks, float),
        points=np.concatenate([scene.shot.points for scene in scenes]),
        is_outlier=kinds == _OUTLIER,
        is_moving=kinds == _MOVING,
        pixels=_block_diagonal([scene.pixels for scene in scenes], np.nan)[content],
        visible=_block_diagonal([scene.visible for scene in scenes], False)[content],
        tracking_error=replace(error, coefficients_px=error.coefficients_px[content]),
        body_of_track=np.concatenate([scene.shot.bodies.body_of_track for scene in scenes]),
        scene_of_track=np.repeat(np.arange(len(counts)), counts),
        schedule=schedule,
        shots=tuple(scene.shot for scene in scenes),
    )


def _stream(seed: int, purpose: bytes, name: str) -> np.random.Generator:
    """A generator for one effect. The options of the effect then change neither the scene nor the noise."""
    return np.random.default_rng((seed, *purpose, *name.encode()))


@dataclass(frozen=True, eq=False)
class _Scene:
    """The tracks of one scene: kinds (M,), true poses (V, 4, 4), measured pixels (V, M, 2), visible (V, M)."""

    shot: Shot
    kinds: Ints
    poses: Floats
    pixels: Floats
    visible: Bools


def _block_diagonal(blocks: list[NDArray[Any]], fill: float | bool) -> NDArray[Any]:
    """Blocks (V_k, M_k, ...) as one array (sum of V_k, sum of M_k, ...)."""
    if len(blocks) == 1:
        return blocks[0]
    rows, columns = (sum(block.shape[axis] for block in blocks) for axis in (0, 1))
    whole = np.full((rows, columns, *blocks[0].shape[2:]), fill, blocks[0].dtype)
    row = column = 0
    for block in blocks:
        whole[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return whole


def _film(
    name: str,
    camera: PinholeCamera,
    ticks: Ints,
    options: PointOptions,
    rng: np.random.Generator,
    body_rng: np.random.Generator,
) -> tuple[Shot, Ints]:
    """Draw the world, the path and the bodies of a scene; and the kind of each track (M,)."""
    interval_s, last_tick = 1 / options.fps, int(ticks[-1])
    if name in HAND_LAYOUTS:
        handling = Handling(last_tick * interval_s, options.turning_deg_s, options.speed)
        layout = HAND_LAYOUTS[name](rng, handling)
    else:
        layout = LAYOUTS[name](rng)
    depth = _median_depth(layout, camera, rng)
    scale = depth if layout.in_depths else options.baseline * depth
    phases, sizes = rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform(0.3, 1.0, (2, 3))
    path = PointPath(layout, scale, last_tick, phases, sizes)
    poses = np.stack([path.at_frame(int(tick)) for tick in ticks])
    draw = _spread_points if layout.in_depths else _points
    points = draw(layout, poses, camera, options, rng)
    kinds, clusters = _kinds(points, options, rng)
    # Each body moves about as fast as the camera, in its own direction. Where the camera does not translate, the
    # speed is that of the default baseline.
    reach = options.baseline * depth
    if reach == 0:
        reach = PointOptions.baseline * float(np.median(np.linalg.norm(points, axis=1)))
    bodies = _bodies(points, clusters, reach, last_tick * interval_s, options, rng, body_rng)
    size = camera.width, camera.height
    shutter = Shutter(options.readout_ms / 1000, options.readout_direction, *size)
    shot = Shot(camera, shutter, path, bodies, points, interval_s, options.exposure_ms / 1000, options.stabilized)
    return shot, kinds


def _median_depth(layout: Layout, camera: PinholeCamera, rng: np.random.Generator) -> float:
    rays = camera.rays(rng.uniform((0, 0), (camera.width, camera.height), (500, 2)))
    depths = layout.depth(np.zeros((500, 3)), rays)
    return float(np.median(depths[depths > 0]))


def _candidates(layout: Layout, poses: Floats, camera: PinholeCamera, count: int, rng: np.random.Generator) -> Floats:
    """Points on the surfaces (M, 3), in the world, at random pixels of random views; some rays meet no surface."""
    view = rng.integers(0, len(poses), count)
    rays = camera.rays(rng.uniform((0, 0), (camera.width, camera.height), (count, 2)))
    rays = np.einsum("nij,nj->ni", poses[view, :3, :3], rays)
    origins = poses[view, :3, 3]
    depth = layout.depth(origins, rays)
    ends = origins + depth[:, None] * rays
    return np.asarray(ends[depth > 0])


def _points(
    layout: Layout, poses: Floats, camera: PinholeCamera, options: PointOptions, rng: np.random.Generator
) -> Floats:
    """Points (M, 3) that the views see, in the world."""
    found = np.zeros((0, 3))
    wanted = max(1, round(_TRACKS_BY_VISIBLE * options.points))
    while len(found) < wanted:
        found = np.concatenate([found, _candidates(layout, poses, camera, 2 * wanted, rng)])
    return found[:wanted]


def _spread_points(
    layout: Layout, poses: Floats, camera: PinholeCamera, options: PointOptions, rng: np.random.Generator
) -> Floats:
    """Points (M, 3) that are spread evenly over what the views see, about ``options.points`` of them in each view.

    A candidate that n views see is drawn n times as often as one that a single view sees. It is therefore taken with
    the probability 1 / n.
    """
    poses = poses[np.unique(np.linspace(0, len(poses) - 1, _SPREAD_VIEWS).round().astype(int))]
    size = np.array([camera.width, camera.height], float)
    found, views_of, wanted = np.zeros((0, 3)), np.zeros(0), options.points * len(poses)
    while views_of.sum() < wanted:
        ends = _candidates(layout, poses, camera, 2 * options.points, rng)
        seen = np.zeros(len(ends))
        for pose in poses:
            X = (ends - pose[:3, 3]) @ pose[:3, :3]
            ahead = X[:, 2] > 0
            pixels = camera.project(np.where(ahead[:, None], X, [0.0, 0.0, 1.0]))
            seen += ahead & (pixels >= 0).all(axis=1) & (pixels <= size - 1).all(axis=1)
        taken = rng.random(len(ends)) * np.maximum(seen, 1) < 1
        found, views_of = np.concatenate([found, ends[taken]]), np.concatenate([views_of, seen[taken]])
    return found[: int(np.searchsorted(np.cumsum(views_of), wanted)) + 1]


def _kinds(points: Floats, options: PointOptions, rng: np.random.Generator) -> tuple[Ints, Ints]:
    """(M,) kind of each track, and (M,) the cluster of each moving one, else -1.

    Moving bodies are compact in the first view; outliers are random tracks.
    """
    count = len(points)
    kinds, clusters = np.full(count, _STATIC, np.int64), np.full(count, -1, np.int64)
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    for body in range(options.bodies):
        size = round(options.moving * count * (body + 1) / options.bodies) - int(np.sum(kinds == _MOVING))
        centre = direction[rng.integers(count)]
        nearest = np.argsort(-direction @ centre + 10.0 * (kinds == _MOVING), kind="stable")
        kinds[nearest[:size]] = _MOVING
        clusters[nearest[:size]] = body
    rest = rng.permutation(np.flatnonzero(kinds == _STATIC))
    kinds[rest[: round(options.outliers * count)]] = _OUTLIER
    return kinds, clusters


def _bodies(
    points: Floats,
    clusters: Ints,
    reach: float,
    duration_s: float,
    options: PointOptions,
    rng: np.random.Generator,
    body_rng: np.random.Generator,
) -> Bodies:
    """The moving bodies. Their translation is 0.5 to 1.5 times ``reach``."""
    count = options.bodies
    body_of_track = clusters
    if count == 2 and options.body_turn_deg_s == 0:
        # Two bodies that do not turn keep the division by the order of the tracks, with which these worlds were first
        # measured: each of the two motions has tracks of both clusters.
        moving = np.flatnonzero(clusters >= 0)
        body_of_track = clusters.copy()
        body_of_track[moving] = np.arange(len(moving)) < len(moving) // 2
    shift = rng.normal(size=(count, 3))
    shift *= reach * rng.uniform(0.5, 1.5, (count, 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    axes = body_rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    centres = np.zeros((count, 3))
    for body in range(count):
        own = body_of_track == body
        centres[body] = points[own].mean(axis=0) if own.any() else 0.0
    return Bodies(body_of_track, shift, np.radians(options.body_turn_deg_s * duration_s) * axes, centres)


def _measure(
    shot: Shot,
    kinds: Ints,
    ticks: Ints,
    first_view: int,
    error: TrackingError,
    options: PointOptions,
    rng: np.random.Generator,
    blur_rng: np.random.Generator,
) -> tuple[Floats, Bools]:
    """Measured pixels (V, M, 2), and which tracks each view sees (V, M)."""
    size = np.array([shot.camera.width, shot.camera.height], float)
    pixels = np.empty((len(ticks), len(kinds), 2))
    visible = np.empty(pixels.shape[:2], bool)
    for view, tick in enumerate(ticks.tolist()):
        truth = shot.see(tick)
        true = truth.pixels
        measured = true + options.noise_px * rng.normal(size=true.shape) + error.at(first_view + view, true)
        if options.exposure_ms > 0:
            # Across the motion the noise is that of a sharp image. The normal draw along the motion is a scalar.
            measured = measured + _BLUR * truth.smear_px * blur_rng.normal(size=(len(true), 1))
        anywhere = rng.uniform(0, size - 1, measured.shape)
        pixels[view] = np.where((kinds == _OUTLIER)[:, None], anywhere, measured)
        inside = ((pixels[view] >= 0) & (pixels[view] <= size - 1)).all(axis=1)
        visible[view] = truth.visible & inside
    return pixels, visible
