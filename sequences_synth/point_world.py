"""The world of a sequence of tracks: points on the surfaces of a scene, moving objects, and the path of the camera."""

from __future__ import annotations

import numpy as np

from sequences_synth.arrays import Floats, Ints
from sequences_synth.camera import PinholeCamera
from sequences_synth.options import PointOptions
from sequences_synth.point_scenes import HAND_LAYOUTS, LAYOUTS, Layout
from sequences_synth.point_shot import Bodies, PointPath, Shot
from sequences_synth.shutter import Shutter
from sequences_synth.trajectory import Handling

# Number of tracks of a sequence over the number of visible points in a view: points leave the view and others enter.
_TRACKS_BY_VISIBLE = 1.15
# The points of a hand-held scene are spread evenly over what this many views see. The other views lie between them.
_SPREAD_VIEWS = 60
#: What a track is: a point of the scene at rest, a point on a moving body, or an outlier.
STATIC, MOVING, OUTLIER = 0, 1, 2


def film(
    name: str,
    camera: PinholeCamera,
    ticks: Ints,
    options: PointOptions,
    rng: np.random.Generator,
    body_rng: np.random.Generator,
) -> tuple[Shot, Ints]:
    """Draw the world, the path and the bodies of a scene.

    Shapes: ``ticks`` (V,), returns ``kinds`` (M,).
    """
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

    Moving objects are compact in the first view; outliers are random tracks.
    """
    count = len(points)
    kinds, clusters = np.full(count, STATIC, np.int64), np.full(count, -1, np.int64)
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    for body in range(options.bodies):
        size = round(options.moving * count * (body + 1) / options.bodies) - int(np.sum(kinds == MOVING))
        centre = direction[rng.integers(count)]
        nearest = np.argsort(-direction @ centre + 10.0 * (kinds == MOVING), kind="stable")
        kinds[nearest[:size]] = MOVING
        clusters[nearest[:size]] = body
    rest = rng.permutation(np.flatnonzero(kinds == STATIC))
    kinds[rest[: round(options.outliers * count)]] = OUTLIER
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
    """The moving objects. Their translation is 0.5 to 1.5 times ``reach``."""
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
