"""Scenes indoors: `room`, `static`, `rotation` and `rotate-then-move` in a furnished room; `corridor`; `desk`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.builder import HAND_DEG, Setup, curved_path, hand_jitter, linear_angles
from sequences_synth.textured_quad import Painter, Quad, box
from sequences_synth.trajectory import Jitter, Path, progress

# A standing person who looks about level sees no floor nearer than this.
_LEVEL_GAZE_M = 2.0
# Range of the frame at which the translation of `rotate-then-move` starts.
_FIRST_TRANSLATION_FRAME = (40.0, 50.0)


def room(setup: Setup) -> tuple[list[Quad], Path]:
    """Build a furnished room; the camera is held by hand and moves mostly sideways."""
    rng = setup.rng
    side = setup.random_sign()
    travel = rng.uniform(0.9, 1.3)
    along = travel * np.array([side, rng.uniform(-0.1, 0.45), rng.uniform(-0.15, 0.15)])
    bend = np.array([0, rng.uniform(-0.1, 0.15), rng.uniform(-0.08, 0.08)])
    start = np.array([-0.4 * along[0] + rng.uniform(-0.2, 0.2), 0.0, rng.uniform(1.25, 1.6)])
    turn_by = np.radians([side * rng.uniform(-3, 11), rng.uniform(-4, 4), rng.uniform(-4, 4)])
    turn_from = np.radians([rng.uniform(-8, 8), rng.uniform(-10, 0), rng.uniform(-2, 2)])
    path = Path(
        centre=curved_path(start, along, bend), angles=linear_angles(turn_from, turn_by), slow_start=setup.slow_start,
        jitter=hand_jitter(setup, 3.0),
    )  # fmt: skip
    return furnished_room(setup, start), path


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


def static(setup: Setup) -> tuple[list[Quad], Path]:
    """Build the furnished room, seen by a static camera."""
    quads, path = room(setup)
    start, angles = path.centre(0.0), path.angles(0.0)
    return quads, Path(centre=lambda _: start, angles=lambda _: angles, slow_start=0.0)


def rotation(setup: Setup) -> tuple[list[Quad], Path]:
    """Build the furnished room, seen by a rotation-only camera: it turns about its optical centre, without parallax."""
    rng = setup.rng
    start = np.array([rng.uniform(-0.4, 0.4), 0.0, rng.uniform(1.2, 1.6)])
    pan = setup.random_sign() * rng.uniform(25, 45)
    turn_from = np.radians([-0.5 * pan, rng.uniform(-8, 0), rng.uniform(-2, 2)])
    turn_by = np.radians([pan, rng.uniform(-8, 8), rng.uniform(-4, 4)])
    jitter = Jitter.draw(rng, HAND_DEG, 0.0)
    path = Path(lambda _: start, linear_angles(turn_from, turn_by), setup.slow_start, jitter=jitter)
    return furnished_room(setup, start), path


def rotate_then_move(setup: Setup) -> tuple[list[Quad], Path]:
    """Build the scene `rotation` in which the camera starts to move sideways after 40 to 50 frames."""
    quads, rotating = rotation(setup)
    rng = setup.rng
    start = rotating.centre(0.0)
    move_from = float(rng.uniform(*_FIRST_TRANSLATION_FRAME))
    # Sideways with respect to the heading at the frame at which the translation starts.
    yaw = rotating.angles(progress(move_from, setup.slow_start))[0]
    side = setup.random_sign()
    sideways, ahead = side * np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([-np.sin(yaw), np.cos(yaw), 0])
    # The whole translation has to fit into half of the frames.
    along = rng.uniform(1.7, 2.1) * (sideways + rng.uniform(0, 0.3) * ahead)
    bend = np.array([0, 0, rng.uniform(-0.1, 0.1)])
    return quads, replace(rotating, centre=curved_path(start, along, bend), move_from=move_from)


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
