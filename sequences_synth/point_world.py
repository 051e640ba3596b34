"""The world of a sequence of tracks: points on the surfaces of a scene, moving objects, and a camera on its path.

The path is a continuous function of the time, since a rolling shutter sees each pixel at the time of its own row, and
the row is that in which the pixel lies. The projection of a point is therefore a fixed point: of the row, to the time,
to the pose, and to the projected row. The iteration contracts by the rows that the image moves in the time in which one
row is read, at most a few tenths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Bools, Floats, Ints
from sequences_synth.camera import Shutter, SynthCamera
from sequences_synth.options import PointOptions
from sequences_synth.point_scenes import LAYOUTS, Layout
from sequences_synth.trajectory import Handling, rotation_from_vector, rotations_from_vectors

# Frequencies of the tremor, periods over the whole path: rotation, translation.
_WAVES = np.array([[1.0, 1.3, 0.8], [1.1, 0.7, 1.4]])
# The tremor of a steady hand: a third of a degree, and a hundredth of the path length.
_SHAKE_RAD, _OFFSET = np.radians(0.3), 0.01


@dataclass(frozen=True, eq=False)
class PointPath:
    """The path of a camera. Its argument is the tick: the time in frame intervals, not necessarily whole."""

    layout: Layout
    #: Unit of the path in metres.
    scale: float
    #: Tick at which the path ends. Rows of the first and last frame lie a little outside.
    last_tick: int
    #: phases_rad, sizes: (2, 3) Tremor of rotation and translation.
    phases_rad: Floats
    sizes: Floats

    def at_frame(self, tick: int) -> Floats:
        """Compute the pose at a frame.

        Shapes: returns (4, 4).
        """
        s = np.array(tick / self.last_tick)
        shake, offset = self._tremor(s)
        pose = np.eye(4)
        pose[:3, :3] = rotation_from_vector(self.layout.rotation(s)) @ rotation_from_vector(shake)
        pose[:3, 3] = self.scale * (self.layout.position(s) + offset * self._moves(np.array(tick)))
        return pose

    def at(self, ticks: Floats) -> Floats:
        """Compute the poses at any times.

        Shapes: ``ticks`` (N,), returns (N, 4, 4).
        """
        s = ticks / self.last_tick
        shake, offset = self._tremor(s)
        # The tremor of the position starts with the translation, from one frame to the next.
        before = np.floor(ticks)
        weight = ticks - before
        moves = (1 - weight) * self._moves(before) + weight * self._moves(before + 1)
        poses = np.tile(np.eye(4), (len(ticks), 1, 1))
        rotations = rotations_from_vectors(self.layout.rotation(s))
        poses[:, :3, :3] = rotations @ rotations_from_vectors(shake) if self.layout.tremor else rotations
        poses[:, :3, 3] = self.scale * (self.layout.position(s) + offset * moves[:, None])
        return poses

    def _tremor(self, s: Floats) -> tuple[Floats, Floats]:
        """Rotation vectors (..., 3) and offsets (..., 3) of the tremor, the latter in units of the path."""
        if not self.layout.tremor:
            return np.zeros((*np.shape(s), 3)), np.zeros((*np.shape(s), 3))
        waves = self.sizes * np.sin(self.phases_rad + 2 * np.pi * s[..., None, None] * _WAVES)
        return _SHAKE_RAD * waves[..., 0, :], _OFFSET * waves[..., 1, :]

    def _moves(self, ticks: Floats) -> Floats:
        """(...) 1 where the camera has left its start, else 0. A camera that does not translate has no such tremor."""
        moves = bool(np.any(self.layout.position(np.array(1.0))))
        gone = np.any(self.layout.position(ticks / self.last_tick), axis=-1)
        return np.asarray(moves * (ticks > 0) * gone, float)


@dataclass(frozen=True, eq=False)
class MovingObjects:
    """Rigid moving objects that translate steadily and turn steadily about their own centres."""

    #: (M,) Number of the object to which a track belongs, -1 where it belongs to none.
    object_of_track: Ints
    #: (B, 3) Translation from the first to the last tick of the path, metres.
    shift: Floats
    #: (B, 3) Rotation vector of the same time.
    turn_rad: Floats
    #: (B, 3) Centre of the turning at the first tick, metres.
    centre: Floats

    def displaced(self, points: Floats, progress: Floats | float) -> Floats:
        """Move the points that lie on moving objects.

        Shapes: ``points`` (M, 3), ``progress`` (M,), returns (M, 3).
        """
        X = points.copy()
        moving = np.flatnonzero(self.object_of_track >= 0)
        label = self.object_of_track[moving]
        s = np.asarray(progress)
        share = s[moving, None] if s.ndim else s
        if self.turn_rad.any():
            around = X[moving] - self.centre[label]
            turned = rotations_from_vectors(share * self.turn_rad[label]) @ around[..., None]
            X[moving] = self.centre[label] + turned[..., 0]
        X[moving] += share * self.shift[label]
        return X


# -- views -----------------------------------------------------------------------------------------


# A point nearer than this share of the median depth is not visible: it would be out of focus.
_NEAREST = 0.05
# The iteration ends where no pixel moves by more than this. A point that does not converge is not visible: it would be
# seen several times, or not at all.
_CONVERGED_PX = 1e-9
_ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class Shot:
    """A camera on its path through a world of points."""

    #: The true camera.
    camera: SynthCamera
    shutter: Shutter
    path: PointPath
    objects: MovingObjects
    #: (M, 3) In the world frame at the first frame, metres.
    points: Floats
    #: Time from one tick to the next.
    interval_s: float

    def see(self, tick: int) -> tuple[Floats, Bools]:
        """Project the points without noise.

        Shapes: returns ``pixels`` (M, 2), returns ``visible`` (M,).

        * Returns ``pixels``: Meaningless for points that are not visible.
        """
        pose = self.path.at_frame(tick)
        X = (self.objects.displaced(self.points, tick / self.path.last_tick) - pose[:3, 3]) @ pose[:3, :3]
        pixels, ahead = self._project(X)
        if self.shutter.readout_s > 0:
            pixels, ahead = self._roll(tick, pixels, ahead)
        return pixels, ahead & inside(self.camera, pixels)

    def _roll(self, tick: int, exposed: Floats, ahead: Bools) -> tuple[Floats, Bools]:
        """Pixels with the shutter, from those without it, and which are seen."""
        size = np.array([self.camera.width, self.camera.height], float)
        change = np.full(len(exposed), np.inf)
        for _ in range(_ITERATIONS):
            # A row outside of the image has no time of its own. The bound keeps the iteration finite there.
            ticks = tick + self.shutter.delay_s(np.clip(exposed, -size, 2 * size)) / self.interval_s
            before, poses = exposed, self.path.at(ticks)
            X = self.objects.displaced(self.points, ticks / self.path.last_tick) - poses[:, :3, 3]
            exposed, ahead = self._project(np.asarray(np.einsum("ni,nij->nj", X, poses[:, :3, :3])))
            change = np.abs(exposed - before).max(axis=1)
            if not (change[ahead & inside(self.camera, exposed)] > _CONVERGED_PX).any():
                break
        return exposed, ahead & (change <= _CONVERGED_PX)

    def _project(self, X: Floats) -> tuple[Floats, Bools]:
        """Pixels of camera points, and which of these lie before the camera and within its lens."""
        ahead = X[:, 2] > _NEAREST * np.median(np.abs(X[:, 2]))
        X = np.column_stack([X[:, :2], np.where(ahead, X[:, 2], 1.0)])
        if not self.camera.is_pinhole:
            ahead &= np.linalg.norm(X[:, :2], axis=1) < np.tan(self.camera.half_field_rad) * X[:, 2]
        return self.camera.project(X), ahead


def inside(camera: SynthCamera, pixels: Floats) -> Bools:
    """Find the pixels (..., 2) that lie in the image of a camera."""
    size = np.array([camera.width, camera.height], float)
    return np.asarray(((pixels >= 0) & (pixels <= size - 1)).all(axis=-1))


# -- the draw --------------------------------------------------------------------------------------


# Number of tracks of a sequence over the number of visible points in a view: points leave the view and others enter.
_TRACKS_BY_VISIBLE = 1.15
# The points of a hand-held scene are spread evenly over what this many views see. The other views lie between them.
_SPREAD_VIEWS = 60
#: What a track is: a point of the scene at rest, a point on a moving object, or an outlier.
STATIC, MOVING, OUTLIER = 0, 1, 2


def film(
    name: str, camera: SynthCamera, options: PointOptions, rng: np.random.Generator, object_rng: np.random.Generator
) -> tuple[Shot, Ints]:
    """Draw the world, the path and the moving objects of a scene.

    Shapes: returns ``kinds`` (M,).
    """
    interval_s, last_tick = 1 / options.fps, options.views - 1
    layout = LAYOUTS[name](rng, Handling(last_tick * interval_s, options.turning_deg_s, options.speed))
    depths = layout.depth(np.zeros((500, 3)), _rays(camera, 500, rng))
    depth = float(np.median(depths[depths > 0]))
    scale = depth if layout.in_depths else options.baseline * depth
    phases, sizes = rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform(0.3, 1.0, (2, 3))
    path = PointPath(layout, scale, last_tick, phases, sizes)
    poses = np.stack([path.at_frame(tick) for tick in range(options.views)])
    draw = _spread_points if layout.in_depths else _points
    points = draw(layout, poses, camera, options, rng)
    kinds, clusters = _kinds(points, options, rng)
    # Each object moves about as fast as the camera, in its own direction. Where the camera does not translate, the
    # speed is that of the default baseline.
    reach = options.baseline * depth
    if reach == 0:
        reach = PointOptions.baseline * float(np.median(np.linalg.norm(points, axis=1)))
    objects = _moving_objects(points, clusters, reach, last_tick * interval_s, options, rng, object_rng)
    shutter = Shutter(options.readout_ms / 1000, options.readout_direction, camera.width, camera.height)
    return Shot(camera, shutter, path, objects, points, interval_s), kinds


def _rays(camera: SynthCamera, count: int, rng: np.random.Generator) -> Floats:
    """Rays (N, 3) of random pixels, with z = 1 in the frame of the camera; that of the axis where a lens sees none."""
    rays = camera.rays(rng.uniform((0, 0), (camera.width, camera.height), (count, 2)))
    return np.where(rays[:, 2:] > 0, rays / np.where(rays[:, 2:] > 0, rays[:, 2:], 1.0), [0.0, 0.0, 1.0])


def _candidates(layout: Layout, poses: Floats, camera: SynthCamera, count: int, rng: np.random.Generator) -> Floats:
    """Points on the surfaces (M, 3), in the world, at random pixels of random views; some rays meet no surface."""
    view = rng.integers(0, len(poses), count)
    rays = np.einsum("nij,nj->ni", poses[view, :3, :3], _rays(camera, count, rng))
    origins = poses[view, :3, 3]
    depth = layout.depth(origins, rays)
    ends = origins + depth[:, None] * rays
    return np.asarray(ends[depth > 0])


def _points(
    layout: Layout, poses: Floats, camera: SynthCamera, options: PointOptions, rng: np.random.Generator
) -> Floats:
    """Points (M, 3) that the views see, in the world."""
    found = np.zeros((0, 3))
    wanted = max(1, round(_TRACKS_BY_VISIBLE * options.points))
    while len(found) < wanted:
        found = np.concatenate([found, _candidates(layout, poses, camera, 2 * wanted, rng)])
    return found[:wanted]


def _spread_points(
    layout: Layout, poses: Floats, camera: SynthCamera, options: PointOptions, rng: np.random.Generator
) -> Floats:
    """Points (M, 3) that are spread evenly over what the views see, about ``options.points`` of them in each view.

    A candidate that n views see is sampled n times as often as one that a single view sees. It is therefore taken with
    the probability 1 / n.
    """
    poses = poses[np.unique(np.linspace(0, len(poses) - 1, _SPREAD_VIEWS).round().astype(int))]
    found, views_of, wanted = np.zeros((0, 3)), np.zeros(0), options.points * len(poses)
    while views_of.sum() < wanted:
        ends = _candidates(layout, poses, camera, 2 * options.points, rng)
        seen = np.zeros(len(ends))
        for pose in poses:
            X = (ends - pose[:3, 3]) @ pose[:3, :3]
            ahead = X[:, 2] > 0
            pixels = camera.project(np.where(ahead[:, None], X, [0.0, 0.0, 1.0]))
            seen += ahead & inside(camera, pixels)
        taken = rng.random(len(ends)) * np.maximum(seen, 1) < 1
        found, views_of = np.concatenate([found, ends[taken]]), np.concatenate([views_of, seen[taken]])
    return found[: int(np.searchsorted(np.cumsum(views_of), wanted)) + 1]


def _kinds(points: Floats, options: PointOptions, rng: np.random.Generator) -> tuple[Ints, Ints]:
    """(M,) kind of each track, and (M,) the cluster of each moving one, else -1.

    Moving objects are compact in the first view; outliers are random tracks.
    """
    count = len(points)
    kinds, clusters = np.full(count, STATIC, np.int64), np.full(count, -1, np.int64)
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    for label in range(options.objects):
        size = round(options.moving * count * (label + 1) / options.objects) - int(np.sum(kinds == MOVING))
        centre = direction[rng.integers(count)]
        nearest = np.argsort(-direction @ centre + 10.0 * (kinds == MOVING), kind="stable")
        kinds[nearest[:size]] = MOVING
        clusters[nearest[:size]] = label
    rest = rng.permutation(np.flatnonzero(kinds == STATIC))
    kinds[rest[: round(options.outliers * count)]] = OUTLIER
    return kinds, clusters


def _moving_objects(
    points: Floats,
    clusters: Ints,
    reach: float,
    duration_s: float,
    options: PointOptions,
    rng: np.random.Generator,
    object_rng: np.random.Generator,
) -> MovingObjects:
    """The moving objects. Their translation is 0.5 to 1.5 times ``reach``."""
    count = options.objects
    object_of_track = clusters
    if count == 2 and options.object_deg_s == 0:
        # Two moving objects that do not turn keep the division by the order of the tracks, with which these worlds were
        # first measured: each of the two motions has tracks of both clusters.
        moving = np.flatnonzero(clusters >= 0)
        object_of_track = clusters.copy()
        object_of_track[moving] = np.arange(len(moving)) < len(moving) // 2
    shift = rng.normal(size=(count, 3))
    shift *= reach * rng.uniform(0.5, 1.5, (count, 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    axes = object_rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    centres = np.zeros((count, 3))
    for label in range(count):
        own = object_of_track == label
        centres[label] = points[own].mean(axis=0) if own.any() else 0.0
    return MovingObjects(object_of_track, shift, np.radians(options.object_deg_s * duration_s) * axes, centres)
