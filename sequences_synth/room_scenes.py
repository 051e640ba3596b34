"""Scenes in a furnished room: `room`, `static`, `rotation`, `rotate-then-move`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sequences_synth.builder import HAND_DEG, Setup, curved_path, hand_jitter, linear_angles
from sequences_synth.textured_quad import Painter, Quad, box
from sequences_synth.trajectory import Jitter, Path, progress

Floats = NDArray[np.float64]

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
