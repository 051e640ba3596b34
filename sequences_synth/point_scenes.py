"""The scenes of :mod:`sequences_synth.points`: depth along a ray, and motion of the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.trajectory import BEND_RAD_S, Handling, HandTurning, arc, rotation_from_vector

# Progress (...) -> vector (..., 3).
PathFunction = Callable[[Floats], Floats]

# Distances of the points or of the wall in a hand-held scene, metres.
_NEAR_M, _FAR_M = 1.0, 4.0
# Normal of the wall of `handheld-wall` to the axis about which the camera oscillates, and largest tilt of the optical
# axis from it. The corners of the image are 41 degrees off the optical axis; with both angles they still meet the wall
# within three times its distance, the bound of `_plane`.
_WALL_DEG, _WALL_TILT_DEG = 12.0, 15.0


@dataclass(frozen=True, eq=False)
class Layout:
    """A scene: its surfaces and the motion of the camera."""

    #: Origins (N, 3) and rays (N, 3) in world axes -> depth (N,) along the rays, which have z = 1 in the frame of
    #: their camera. A depth of 0 or less means that the ray meets no surface.
    depth: Callable[[Floats, Floats], Floats]
    #: Progress s (...) -> camera centre (..., 3). The frames have s in [0, 1]; rows of the first and last frame lie a
    #: little outside. The ends of the path are about 1 apart; with ``in_depths`` the unit is the median depth.
    position: PathFunction
    #: Progress s (...) -> rotation vector (..., 3) of world_from_cam, radians.
    rotation: PathFunction
    #: Whether the tremor of a hand is added.
    tremor: bool = True
    #: Whether the unit of the path is the median depth of the scene, and not the baseline of the options. The points
    #: of such a scene are spread over all that the camera sees.
    in_depths: bool = False


def _cloud(rng: np.random.Generator) -> Callable[[Floats, Floats], Floats]:
    """Random depths from 1 to 4 m, independent of the ray."""
    return lambda origins, rays: rng.uniform(_NEAR_M, _FAR_M, len(rays))


def _plane(normal: Floats, distance: float) -> Callable[[Floats, Floats], Floats]:
    """Depth along rays to the plane ``normal . X = distance``; no surface beyond three times the distance."""

    def depth(origins: Floats, rays: Floats) -> Floats:
        towards = rays @ normal
        reached = (distance - origins @ normal) / np.where(towards > 0.05, towards, np.inf)
        return np.asarray(np.where(reached < 3 * distance, reached, 0.0))

    return depth


def _tunnel(rng: np.random.Generator) -> Callable[[Floats, Floats], Floats]:
    """Four walls along z; no surface at a depth of 10 or more."""
    half = np.array([rng.uniform(0.9, 1.3), rng.uniform(0.7, 1.0)])

    def depth(origins: Floats, rays: Floats) -> Floats:
        side = np.where(rays[:, :2] >= 0, half, -half)
        across = np.where(np.abs(rays[:, :2]) > 1e-6, rays[:, :2], 1e-6)
        reached = np.min((side - origins[:, :2]) / across, axis=1)
        return np.where(reached < 10.0, reached, 0.0)

    return depth


def _with_objects_on_it(
    rng: np.random.Generator, plane: Callable[[Floats, Floats], Floats]
) -> Callable[[Floats, Floats], Floats]:
    """A quarter of the points lie up to a fifth of their distance in front of the plane."""

    def depth(origins: Floats, rays: Floats) -> Floats:
        lifted = rng.uniform(0.8, 1.0, len(rays)) * (rng.random(len(rays)) < 0.25)
        return np.asarray(plane(origins, rays) * np.where(lifted > 0, lifted, 1.0))

    return depth


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.linalg.norm(vector))


def _times(s: Floats, vector: Floats) -> Floats:
    return np.asarray(np.asarray(s)[..., None] * vector)


def _straight(direction: Floats, bend: Floats | float = 0.0) -> PathFunction:
    """Path of unit length along a direction; ``bend`` is the largest departure from the straight line."""
    return lambda s: _times(s, direction) + _times(4 * s * (1 - s), np.asarray(bend))


def _no_motion(s: Floats) -> Floats:
    return np.zeros((*np.shape(s), 3))


def _hand_position(rng: np.random.Generator) -> PathFunction:
    """A curved path, mostly sideways, as of a hand-held camera."""
    direction = _unit(rng.normal(size=3) * [1.0, 0.6, 0.5])
    bend = np.cross(direction, _unit(rng.normal(size=3)))
    return _straight(direction, rng.uniform(0.05, 0.2) * bend)


def _hand_rotation(rng: np.random.Generator) -> PathFunction:
    """2 to 6 degrees about any axis."""
    total = np.radians(rng.uniform(2, 6)) * _unit(rng.normal(size=3))
    return lambda s: _times(s, total)


def _pan(rng: np.random.Generator) -> PathFunction:
    """10 to 20 degrees, mostly about the vertical axis."""
    total = np.radians(rng.uniform(10, 20)) * _unit(rng.normal(size=3) * 0.2 + [0, rng.choice([-1.0, 1.0]), 0])
    return lambda s: _times(s, total)


def _room(rng: np.random.Generator, _: Handling) -> Layout:
    return Layout(_cloud(rng), _hand_position(rng), _hand_rotation(rng))


def _wall(rng: np.random.Generator, _: Handling) -> Layout:
    normal = _unit(np.array([rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.7), 1.0]))
    return Layout(_plane(normal, 2.0), _hand_position(rng), _hand_rotation(rng))


def _nadir(rng: np.random.Generator, _: Handling) -> Layout:
    """A straight level flight over flat ground; the camera looks straight down."""
    heading = rng.uniform(0, 2 * np.pi)
    position = _straight(np.array([np.cos(heading), np.sin(heading), 0.0]))
    return Layout(_plane(np.array([0.0, 0.0, 1.0]), 2.0), position, _no_motion)


def _nadir_turn(rng: np.random.Generator, _: Handling) -> Layout:
    """A level flight over flat ground in a turn of 30 to 60 degrees; the camera turns with the direction of flight."""
    heading, turn = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(30, 60)) * rng.choice([-1.0, 1.0])

    def position(s: Floats) -> Floats:
        ahead = np.stack([np.sin(turn * s), 1 - np.cos(turn * s), np.zeros(np.shape(s))], axis=-1) / turn
        return np.asarray((rotation_from_vector(np.array([0, 0, heading])) @ ahead[..., None])[..., 0])

    rotation = _straight(np.array([0.0, 0.0, turn]))
    return Layout(_plane(np.array([0.0, 0.0, 1.0]), 2.0), position, rotation)


def _tilted(tilt_deg: float) -> Callable[[np.random.Generator, Handling], Layout]:
    """A straight level flight over flat ground; the camera is tilted from straight down, along or across the track."""

    def draw(rng: np.random.Generator, _: Handling) -> Layout:
        heading = rng.uniform(0, 2 * np.pi)
        # The camera is tilted forward in half of the worlds, and to the left or right in the others.
        towards = heading + rng.choice([0.0, rng.choice([-0.5, 0.5]) * np.pi])
        # The frame "down" is that of the camera before the tilt; its z axis is the normal of the ground. The rotation
        # tilts the optical axis from the normal towards the direction `towards`.
        axis = np.array([-np.sin(towards), np.cos(towards), 0.0])
        cam_from_down = rotation_from_vector(np.radians(tilt_deg) * axis).T
        position = _straight(cam_from_down @ np.array([np.cos(heading), np.sin(heading), 0.0]))
        return Layout(_plane(cam_from_down @ np.array([0.0, 0.0, 1.0]), 2.0), position, _no_motion)

    return draw


def _corridor(rng: np.random.Generator, _: Handling) -> Layout:
    position = _straight(_unit(np.array([*(0.05 * rng.normal(size=2)), 1.0])))
    return Layout(_tunnel(rng), position, _hand_rotation(rng))


def _desk(rng: np.random.Generator, _: Handling) -> Layout:
    # The camera looks down at 40 to 60 degrees. As y points down, the normal of the table leans towards +y.
    down = np.radians(rng.uniform(40, 60))
    plane = _plane(np.array([0.0, np.cos(down), np.sin(down)]), 1.5)
    return Layout(_with_objects_on_it(rng, plane), _hand_position(rng), _hand_rotation(rng))


def _rotation_only(rng: np.random.Generator, _: Handling) -> Layout:
    return Layout(_cloud(rng), _no_motion, _pan(rng))


def _rotate_then_move(rng: np.random.Generator, _: Handling) -> Layout:
    """The translation starts after 30 to 40 % of the views."""
    position, rotation, start = _hand_position(rng), _pan(rng), rng.uniform(0.3, 0.4)
    return Layout(_cloud(rng), lambda s: position(np.maximum(0.0, (s - start) / (1 - start))), rotation)


def _static(rng: np.random.Generator, _: Handling) -> Layout:
    return Layout(_cloud(rng), _no_motion, _no_motion, tremor=False)


def _of_time(path: PathFunction, handling: Handling) -> PathFunction:
    """Turn a path in seconds into one in progress."""
    return lambda s: path(handling.duration_s * np.asarray(s))


def _handheld(rng: np.random.Generator, handling: Handling) -> Layout:
    """Points at 1 to 4 m around a camera that is turned by hand."""
    turning = HandTurning.draw(rng, handling)
    along = _unit(rng.normal(size=3) * [1.0, 0.6, 0.5])
    across = _unit(np.cross(along, rng.normal(size=3)))
    position = _of_time(arc(handling.speed, float(rng.uniform(*BEND_RAD_S)), along, across), handling)
    rotation = _of_time(turning.rotation_vector, handling)
    return Layout(_cloud(rng), position, rotation, tremor=False, in_depths=True)


def _handheld_wall(rng: np.random.Generator, handling: Handling) -> Layout:
    """One wall at 1 to 4 m; the camera oscillates about an axis that points to the wall, and moves along the wall."""
    turning = HandTurning.draw(rng, handling, _WALL_TILT_DEG)
    leaning = np.radians(rng.uniform(3.0, _WALL_DEG)) * _unit(np.array([*rng.normal(size=2), 0.0]))
    right, down, normal = rotation_from_vector(leaning).T
    heading = rng.uniform(0, 2 * np.pi)
    along = np.cos(heading) * right + np.sin(heading) * down
    across = np.cos(heading) * down - np.sin(heading) * right
    position = _of_time(arc(handling.speed, float(rng.uniform(*BEND_RAD_S)), along, across), handling)
    rotation = _of_time(turning.rotation_vector, handling)
    wall = _plane(normal, rng.uniform(_NEAR_M, _FAR_M))
    return Layout(wall, position, rotation, tremor=False, in_depths=True)


def _steady_pan(rng: np.random.Generator, handling: Handling) -> Layout:
    """Points at 1 to 4 m around a camera that turns steadily about the vertical axis and never translates."""
    turn = np.radians(handling.turning_deg_s * handling.duration_s) * rng.choice([-1.0, 1.0])
    return Layout(_cloud(rng), _no_motion, _straight(np.array([0.0, turn, 0.0])), tremor=False, in_depths=True)


#: Scene name -> function that draws the scene from a random generator, and from how the camera is handled.
LAYOUTS: dict[str, Callable[[np.random.Generator, Handling], Layout]] = {
    "room": _room,
    "wall": _wall,
    "nadir": _nadir,
    "nadir-turn": _nadir_turn,
    "corridor": _corridor,
    "desk": _desk,
    "rotation": _rotation_only,
    "rotate-then-move": _rotate_then_move,
    "static": _static,
    "tilted-15": _tilted(15.0),
    "tilted-30": _tilted(30.0),
    "tilted-45": _tilted(45.0),
    "handheld": _handheld,
    "handheld-wall": _handheld_wall,
    "pan": _steady_pan,
}
