"""The surfaces of rooms: walls, pictures, furniture, and the panels of a corridor."""

from __future__ import annotations

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.quads import Painter, Quad, Setup, box

# A standing person who looks about level sees no floor nearer than this.
_LEVEL_GAZE_M = 2.0


def furnished_room(setup: Setup, viewpoint: Floats) -> list[Quad]:
    """Build walls, pictures and boxes around a viewpoint that looks along y. No object is near the camera.

    Shapes: ``viewpoint`` (3,).
    """
    rng = setup.rng
    painter = setup.painter(viewpoint, 1.3)
    left, right = -rng.uniform(2.3, 3.4), rng.uniform(2.3, 3.4)
    front, back, top = rng.uniform(4.2, 6.5), -rng.uniform(1.6, 2.5), rng.uniform(2.5, 3.0)
    quads = _shell(painter, rng, left, right, back, front, top)
    quads += _pictures(painter, rng, left, right, front, top)
    for _ in range(int(rng.integers(9, 15))):
        size = np.array([rng.uniform(0.3, 1.1), rng.uniform(0.3, 0.9), rng.uniform(0.3, 1.3)])
        y = rng.uniform(1.9, front - 0.4)
        # Near objects are low: high ones would hide the room.
        size[2] = min(size[2], 0.35 + 0.3 * y)
        x = rng.uniform(left + 0.4, right - 0.4)
        look = str(rng.choice(["print", "print", "wood", "wall"]))
        quads += box(painter, np.array([x, y, 0.0]), size, rng.uniform(-0.8, 0.8), look)
    return quads


def _shell(
    painter: Painter, rng: np.random.Generator, left: float, right: float, back: float, front: float, top: float
) -> list[Quad]:
    """Floor, ceiling and four walls, each 2 cm too large on every side, so that no ray passes through a corner."""
    m = 0.02
    w, d, h = right - left + 2 * m, front - back + 2 * m, top + 2 * m
    x, y, z = np.array([w, 0, 0]), np.array([0, d, 0]), np.array([0, 0, h])
    lights = rng.uniform(0.75, 1.0, 4)
    return [
        painter.quad(np.array([left - m, front, top + m]), x, -z, "wall", lights[0]),
        painter.quad(np.array([right + m, back, top + m]), -x, -z, "wall", lights[1]),
        painter.quad(np.array([left, back - m, top + m]), y, -z, "wall", lights[2]),
        painter.quad(np.array([right, front + m, top + m]), -y, -z, "wall", lights[3]),
        painter.quad(np.array([left - m, front + m, 0]), x, -y, "wood", 0.9, nearest_m=_LEVEL_GAZE_M),
        painter.quad(np.array([left - m, back - m, top]), x, y, "ceiling", 0.85, nearest_m=_LEVEL_GAZE_M),
    ]


def _pictures(
    painter: Painter, rng: np.random.Generator, left: float, right: float, front: float, top: float
) -> list[Quad]:
    """Pictures and cupboards on the far and the side walls."""
    quads = []
    down = np.array([0, 0, -1.0])
    for _ in range(int(rng.integers(4, 7))):
        w, h, off = rng.uniform(0.5, 1.2), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.3)
        corner = np.array([rng.uniform(left + 0.1, right - w - 0.1), front - off, rng.uniform(1.2, top - 0.1)])
        quads.append(painter.quad(corner, np.array([w, 0, 0]), h * down, "print", rng.uniform(0.8, 1.05)))
    for side, x in ((1, left), (-1, right)):
        for _ in range(2):
            w, h, off = rng.uniform(0.6, 1.2), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.25)
            y = rng.uniform(1.5, front - w)
            start = y if side > 0 else y + w
            corner = np.array([x + side * off, start, rng.uniform(1.2, top - 0.1)])
            quads.append(painter.quad(corner, np.array([0, side * w, 0]), h * down, "print", rng.uniform(0.7, 0.95)))
    return quads


def corridor_walls(painter: Painter, rng: np.random.Generator, half: float, top: float, length: float) -> list[Quad]:
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
