"""The scenes of :mod:`sequences_synth.points`: where a ray ends, and how the camera goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.trajectory import rotation_from_vector

__all__ = ["LAYOUTS", "Layout"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layout:
    """A scene: where a ray ends, and how the camera goes.

    ``depth(origins, rays)`` is the distance along rays (N, 3) with z = 1 in their own camera, in the world's axes, and
    not positive where there is nothing. ``way(s)`` is the position at progress s in 0 .. 1 for a way of unit length,
    ``turn(s)`` the rotation vector.
    """

    depth: Callable[[Floats, Floats], Floats]
    way: Callable[[float], Floats]
    turn: Callable[[float], Floats]
    tremor: bool = True


def _cloud(rng: np.random.Generator) -> Callable[[Floats, Floats], Floats]:
    """Depths 1 to 4, whatever the direction."""
    return lambda origins, rays: rng.uniform(1.0, 4.0, len(rays))


def _plane(normal: Floats, distance: float) -> Callable[[Floats, Floats], Floats]:
    """Depth along rays to the plane ``normal . X = distance``; nothing beyond three times the distance."""

    def depth(origins: Floats, rays: Floats) -> Floats:
        towards = rays @ normal
        reached = (distance - origins @ normal) / np.where(towards > 0.05, towards, np.inf)
        return np.asarray(np.where(reached < 3 * distance, reached, 0.0))

    return depth


def _tunnel(rng: np.random.Generator) -> Callable[[Floats, Floats], Floats]:
    """Four walls along z; nothing farther than ten half-widths."""
    half = np.array([rng.uniform(0.9, 1.3), rng.uniform(0.7, 1.0)])

    def depth(origins: Floats, rays: Floats) -> Floats:
        side = np.where(rays[:, :2] >= 0, half, -half)
        across = np.where(np.abs(rays[:, :2]) > 1e-6, rays[:, :2], 1e-6)
        reached = np.min((side - origins[:, :2]) / across, axis=1)
        return np.where(reached < 10.0, reached, 0.0)

    return depth


def _with_things_on_it(
    rng: np.random.Generator, plane: Callable[[Floats, Floats], Floats]
) -> Callable[[Floats, Floats], Floats]:
    """A quarter of the points lie up to a fifth of their distance in front of the plane."""

    def depth(origins: Floats, rays: Floats) -> Floats:
        lifted = rng.uniform(0.8, 1.0, len(rays)) * (rng.random(len(rays)) < 0.25)
        return np.asarray(plane(origins, rays) * np.where(lifted > 0, lifted, 1.0))

    return depth


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.linalg.norm(vector))


def _straight(direction: Floats, bend: Floats | float = 0.0) -> Callable[[float], Floats]:
    """Unit way in a direction that swings out to the side; the bend is the farthest from the straight line."""
    return lambda s: s * direction + 4 * s * (1 - s) * bend


def _stay(_: float) -> Floats:
    return np.zeros(3)


def _hand_way(rng: np.random.Generator) -> Callable[[float], Floats]:
    """Mostly sideways, in a curve: how a person moves a camera."""
    direction = _unit(rng.normal(size=3) * [1.0, 0.6, 0.5])
    bend = np.cross(direction, _unit(rng.normal(size=3)))
    return _straight(direction, rng.uniform(0.05, 0.2) * bend)


def _hand_turn(rng: np.random.Generator) -> Callable[[float], Floats]:
    """A few degrees about any axis."""
    total = np.radians(rng.uniform(2, 6)) * _unit(rng.normal(size=3))
    return lambda s: s * total


def _pan(rng: np.random.Generator) -> Callable[[float], Floats]:
    """10 to 20 degrees, mostly about the vertical."""
    total = np.radians(rng.uniform(10, 20)) * _unit(rng.normal(size=3) * 0.2 + [0, rng.choice([-1.0, 1.0]), 0])
    return lambda s: s * total


def _room(rng: np.random.Generator) -> Layout:
    return Layout(_cloud(rng), _hand_way(rng), _hand_turn(rng))


def _wall(rng: np.random.Generator) -> Layout:
    normal = _unit(np.array([rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.7), 1.0]))
    return Layout(_plane(normal, 2.0), _hand_way(rng), _hand_turn(rng))


def _nadir(rng: np.random.Generator) -> Layout:
    """Level and straight over flat ground, the camera straight down."""
    heading = rng.uniform(0, 2 * np.pi)
    way = _straight(np.array([np.cos(heading), np.sin(heading), 0.0]))
    return Layout(_plane(np.array([0.0, 0.0, 1.0]), 2.0), way, lambda _: np.zeros(3))


def _nadir_turn(rng: np.random.Generator) -> Layout:
    """The same in a turn of 30 to 60 degrees, the camera turning along."""
    heading, turn = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(30, 60)) * rng.choice([-1.0, 1.0])

    def way(s: float) -> Floats:
        ahead = np.array([np.sin(turn * s), 1 - np.cos(turn * s), 0.0]) / turn
        return np.asarray(rotation_from_vector(np.array([0, 0, heading])) @ ahead)

    return Layout(_plane(np.array([0.0, 0.0, 1.0]), 2.0), way, lambda s: np.array([0.0, 0.0, turn * s]))


def _corridor(rng: np.random.Generator) -> Layout:
    way = _straight(_unit(np.array([*(0.05 * rng.normal(size=2)), 1.0])))
    return Layout(_tunnel(rng), way, _hand_turn(rng))


def _desk(rng: np.random.Generator) -> Layout:
    # Looking down at 40 to 60 degrees: y is down, so the table's normal leans towards +y.
    down = np.radians(rng.uniform(40, 60))
    plane = _plane(np.array([0.0, np.cos(down), np.sin(down)]), 1.5)
    return Layout(_with_things_on_it(rng, plane), _hand_way(rng), _hand_turn(rng))


def _rotation_only(rng: np.random.Generator) -> Layout:
    return Layout(_cloud(rng), _stay, _pan(rng))


def _rotate_then_move(rng: np.random.Generator) -> Layout:
    way, turn, still = _hand_way(rng), _pan(rng), rng.uniform(0.3, 0.4)
    return Layout(_cloud(rng), lambda s: way(max(0.0, (s - still) / (1 - still))), turn)


def _static(rng: np.random.Generator) -> Layout:
    return Layout(_cloud(rng), _stay, lambda _: np.zeros(3), tremor=False)


#: By name, each drawn from a generator.
LAYOUTS: dict[str, Callable[[np.random.Generator], Layout]] = {
    "room": _room,
    "wall": _wall,
    "nadir": _nadir,
    "nadir-turn": _nadir_turn,
    "corridor": _corridor,
    "desk": _desk,
    "rotation": _rotation_only,
    "rotate-then-move": _rotate_then_move,
    "static": _static,
}
