"""Scenes that are neither one plane nor a room: `corridor` and `desk`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sequences_synth.builder import Setup, curved_path, hand_jitter, linear_angles
from sequences_synth.textured_quad import Painter, Quad, box
from sequences_synth.trajectory import Path

Floats = NDArray[np.float64]


def corridor(setup: Setup) -> tuple[list[Quad], Path]:
    """Build a corridor through which the camera is carried forwards."""
    rng = setup.rng
    half, top, length = rng.uniform(1.0, 1.4), rng.uniform(2.3, 2.7), rng.uniform(14, 20)
    start = np.array([rng.uniform(-0.25, 0.25) * half, 0.0, rng.uniform(1.2, 1.6)])
    along = np.array([rng.uniform(-0.08, 0.08), rng.uniform(1.5, 1.9), rng.uniform(-0.05, 0.05)])
    turn_from = np.radians([rng.uniform(-3, 3), rng.uniform(-5, 0), rng.uniform(-1, 1)])
    turn_by = np.radians([rng.uniform(-4, 4), rng.uniform(-2, 2), rng.uniform(-2, 2)])
    path = Path(
        curved_path(start, along, np.zeros(3)),
        linear_angles(turn_from, turn_by),
        setup.slow_start,
        jitter=hand_jitter(setup, 2.0),
    )
    painter = setup.painter(start, 1.4)
    quads = _corridor_walls(painter, rng, half, top, length)
    for _ in range(int(rng.integers(6, 10))):
        side = setup.random_sign()
        size = np.array([rng.uniform(0.25, 0.5), rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.4)])
        centre = np.array([side * (half - 0.5 * size[0]), rng.uniform(3.4, 0.8 * length), 0])
        quads += box(painter, centre, size, 0.0, str(rng.choice(["print", "wood"])))
    return quads, path


def _corridor_walls(painter: Painter, rng: np.random.Generator, half: float, top: float, length: float) -> list[Quad]:
    """Walls, floor and ceiling in panels, with some door frames between them.

    Each panel has a texture as fine as its distance requires.
    """
    quads = []
    x, z, m = np.array([2 * half + 0.04, 0, 0]), np.array([0, 0, top + 0.04]), 0.02
    y0 = -2.0
    while y0 < length:
        step = rng.uniform(1.5, 2.6)
        y, lights = np.array([0, step + 0.01, 0]), rng.uniform(0.75, 1.0, 4)
        quads += [
            painter.quad(np.array([-half, y0, top + m]), y, -z, "wall", lights[0]),
            painter.quad(np.array([half, y0 + step, top + m]), -y, -z, "wall", lights[1]),
            painter.quad(np.array([-half - m, y0 + step, 0]), x, -y, "wood", lights[2]),
            painter.quad(np.array([-half - m, y0, top]), x, y, "ceiling", 0.9 * lights[3]),
        ]
        y0 += step
        if y0 > 2.5 and rng.random() < 0.6:
            depth, width = 0.2, rng.uniform(0.1, 0.25)
            for side in (-1, 1):
                post = np.array([side * (half - 0.5 * width), y0, 0])
                quads += box(painter, post, np.array([width, depth, top]), 0.0, "wood")
            lintel = np.array([0, y0, top - 0.3])
            quads += box(painter, lintel, np.array([2 * half, depth, 0.32]), 0.0, "wood", floating=True)
    quads.append(painter.quad(np.array([-half - m, length, top + m]), x, -z, "print", 0.9))
    return quads


def desk(setup: Setup) -> tuple[list[Quad], Path]:
    """Build a desk top that fills most of the view, with boxes on it; the camera is held by hand above it."""
    rng = setup.rng
    desk_z = 0.75
    pitch = np.radians(-rng.uniform(42, 55))
    distance = rng.uniform(0.85, 1.15)
    # Look at the middle of the desk from its near side.
    middle = np.array([0, 0, desk_z])
    start = middle + distance * np.array([0, -np.cos(pitch), -np.sin(pitch)])
    side = setup.random_sign()
    along = distance * rng.uniform(0.27, 0.36) * np.array([side, rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)])
    bend = distance * np.array([0, rng.uniform(-0.06, 0.06), rng.uniform(-0.05, 0.05)])
    turn_from = np.array([-side * np.radians(rng.uniform(-4, 4)), pitch, np.radians(rng.uniform(-4, 4))])
    turn_by = np.radians([side * rng.uniform(2, 14), rng.uniform(-3, 3), rng.uniform(-5, 5)])
    start = start - 0.5 * along
    centre, angles = curved_path(start, along, bend), linear_angles(turn_from, turn_by)
    path = Path(centre, angles, setup.slow_start, jitter=hand_jitter(setup, 1.0))
    painter = setup.painter(start, 0.6)
    wide, deep = rng.uniform(1.0, 1.3), rng.uniform(0.75, 0.95)
    quads = [
        painter.quad(
            np.array([-wide, deep, desk_z]), np.array([2 * wide, 0, 0]), np.array([0, -deep - 0.7, 0]), "desk"
        ),
        painter.quad(np.array([-4, 3, 0]), np.array([8.0, 0, 0]), np.array([0, -5.0, 0]), "wood", 0.7),
        painter.quad(np.array([-4, 2.2, 3]), np.array([8.0, 0, 0]), np.array([0, 0, -3.0]), "wall", 0.9),
    ]
    spots = _spread(rng, int(rng.integers(6, 10)), np.array([-0.7, -0.32]), np.array([0.7, 0.6]), 0.24)
    for spot in spots:
        size = np.array([rng.uniform(0.08, 0.2), rng.uniform(0.08, 0.18), rng.uniform(0.04, 0.2)])
        quads += box(painter, np.array([*spot, desk_z]), size, rng.uniform(0, np.pi), "print")
    return quads, path


def _spread(rng: np.random.Generator, count: int, low: Floats, high: Floats, apart: float) -> list[Floats]:
    """Up to ``count`` points (2,) of a rectangle, no two nearer than ``apart``."""
    spots: list[Floats] = []
    for _ in range(20 * count):
        spot = rng.uniform(low, high)
        if len(spots) < count and all(np.linalg.norm(spot - other) >= apart for other in spots):
            spots.append(spot)
    return spots
