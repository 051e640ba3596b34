"""The scenes: what stands where, and how the camera moves through it.

Sizes are metres, the world is z up. Each builder draws the path first, then puts things where the path does not go.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sequences_synth.quad import Painter, Quad, box
from sequences_synth.trajectory import PROGRESS_RANGE, Jitter, Path, progress

__all__ = ["SCENES", "World", "build_world"]

Floats = NDArray[np.float64]

# Hands tremble by a fraction of a degree; a drone's gimbal by less.
_HAND_DEG, _HAND_M = 0.25, 0.004
_GIMBAL_DEG, _GIMBAL_M = 0.08, 0.03
# Frame at which `rotate-then-move` starts to move, and how it speeds up so that the rest of 100 frames has parallax.
_TURN_ONLY_FRAMES = (40.0, 50.0)


@dataclass(frozen=True, eq=False)
class World:
    """A scene and the path through it.

    Attributes
    ----------
    quads : tuple of Quad
    path : Path
    exposure_phase : (float, float)
        Phase at frame 0 and advance per frame, radians, of the slow change of exposure.
    """

    quads: tuple[Quad, ...]
    path: Path
    exposure_phase: tuple[float, float]


@dataclass(frozen=True, eq=False)
class _Setup:
    """What every builder gets."""

    rng: np.random.Generator
    seed: tuple[int, ...]
    K: Floats
    width: int
    height: int
    slow_start: float

    def painter(self, viewpoint: Floats, nearest_m: float) -> Painter:
        return Painter(self.seed, float(self.K[0, 0]), viewpoint, nearest_m)

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))


def build_world(
    name: str, seed: int, K: Floats, width: int, height: int, slow_start: float, moving_share: float
) -> World:
    """Build a scene.

    Parameters
    ----------
    name : str
        Key of the scene, see :data:`SCENES`.
    seed : int
    K : (3, 3) float
        True calibration matrix of the camera that will look.
    width, height : int
        Image size in pixels.
    slow_start : float
        See :class:`sequences_synth.trajectory.Path`.
    moving_share : float
        Share of the image that moving objects cover, about.
    """
    entropy = (seed, *name.encode())
    rng = np.random.default_rng(entropy)
    setup = _Setup(rng, entropy, K, width, height, slow_start)
    quads, path = _BUILDERS[name](setup)
    phase = (float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.03, 0.09)))
    if moving_share > 0:
        quads = quads + _moving_cards(setup, path, quads, moving_share)
    return World(tuple(quads), path, phase)


def _sweep(start: Floats, along: Floats, bend: Floats) -> Callable[[float], Floats]:
    """A curved path: ``start + p along + p^2 bend`` at progress p."""
    return lambda p: start + p * along + p * p * bend


def _turn(start: Floats, by: Floats) -> Callable[[float], tuple[float, float, float]]:
    """Angles that change evenly: yaw, pitch, roll in radians."""

    def angles(p: float) -> tuple[float, float, float]:
        yaw, pitch, roll = (start + p * by).tolist()
        return yaw, pitch, roll

    return angles


def _hand(setup: _Setup, distance_m: float) -> Jitter:
    return Jitter.draw(setup.rng, _HAND_DEG, _HAND_M * min(1.0, distance_m / 2))


# --- room -------------------------------------------------------------------------------------------------------------


def _room(setup: _Setup) -> tuple[list[Quad], Path]:
    """A furnished room; a hand carries the camera mostly sideways."""
    rng = setup.rng
    side = setup.sign()
    travel = rng.uniform(0.9, 1.3)
    along = travel * np.array([side, rng.uniform(-0.1, 0.45), rng.uniform(-0.15, 0.15)])
    bend = np.array([0, rng.uniform(-0.1, 0.15), rng.uniform(-0.08, 0.08)])
    start = np.array([-0.4 * along[0] + rng.uniform(-0.2, 0.2), 0.0, rng.uniform(1.25, 1.6)])
    turn_by = np.radians([side * rng.uniform(-3, 11), rng.uniform(-4, 4), rng.uniform(-4, 4)])
    turn_from = np.radians([rng.uniform(-8, 8), rng.uniform(-10, 0), rng.uniform(-2, 2)])
    path = Path(
        centre=_sweep(start, along, bend), angles=_turn(turn_from, turn_by), slow_start=setup.slow_start,
        jitter=_hand(setup, 3.0),
    )  # fmt: skip
    return _furnished_room(setup, start), path


def _furnished_room(setup: _Setup, viewpoint: Floats) -> list[Quad]:
    """Walls, pictures and boxes around a viewpoint that looks along y, nothing within reach of the camera."""
    rng = setup.rng
    painter = setup.painter(viewpoint, 1.3)
    left, right = -rng.uniform(2.3, 3.4), rng.uniform(2.3, 3.4)
    front, back, top = rng.uniform(4.2, 6.5), -rng.uniform(1.6, 2.5), rng.uniform(2.5, 3.0)
    quads = _shell(painter, rng, left, right, back, front, top)
    quads += _pictures(painter, rng, left, right, front, top)
    for _ in range(int(rng.integers(9, 15))):
        size = np.array([rng.uniform(0.3, 1.1), rng.uniform(0.3, 0.9), rng.uniform(0.3, 1.3)])
        y = rng.uniform(1.9, front - 0.4)
        # Near things stay low, or they would hide the room.
        size[2] = min(size[2], 0.35 + 0.3 * y)
        x = rng.uniform(left + 0.4, right - 0.4)
        look = str(rng.choice(["print", "print", "wood", "wall"]))
        quads += box(painter, np.array([x, y, 0.0]), size, rng.uniform(-0.8, 0.8), look)
    return quads


def _shell(
    painter: Painter,
    rng: np.random.Generator,
    left: float,
    right: float,
    back: float,
    front: float,
    top: float,
) -> list[Quad]:
    """Floor, ceiling and four walls, each a little too large so that no ray slips through a corner."""
    m = 0.02
    w, d, h = right - left + 2 * m, front - back + 2 * m, top + 2 * m
    x, y, z = np.array([w, 0, 0]), np.array([0, d, 0]), np.array([0, 0, h])
    lights = rng.uniform(0.75, 1.0, 4)
    return [
        painter.quad(np.array([left - m, front, top + m]), x, -z, "wall", lights[0]),
        painter.quad(np.array([right + m, back, top + m]), -x, -z, "wall", lights[1]),
        painter.quad(np.array([left, back - m, top + m]), y, -z, "wall", lights[2]),
        painter.quad(np.array([right, front + m, top + m]), -y, -z, "wall", lights[3]),
        painter.quad(np.array([left - m, front + m, 0]), x, -y, "wood", 0.9),
        painter.quad(np.array([left - m, back - m, top]), x, y, "ceiling", 0.85),
    ]


def _pictures(
    painter: Painter, rng: np.random.Generator, left: float, right: float, front: float, top: float
) -> list[Quad]:
    """Pictures and cupboards on the far and the side walls."""
    quads = []
    down = np.array([0, 0, -1.0])
    for _ in range(int(rng.integers(4, 7))):
        w, h, off = rng.uniform(0.5, 1.2), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.3)
        corner = np.array(
            [rng.uniform(left + 0.1, right - w - 0.1), front - off, rng.uniform(1.2, top - 0.1)]
        )
        quads.append(painter.quad(corner, np.array([w, 0, 0]), h * down, "print", rng.uniform(0.8, 1.05)))
    for side, x in ((1, left), (-1, right)):
        for _ in range(2):
            w, h, off = rng.uniform(0.6, 1.2), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.25)
            y = rng.uniform(1.5, front - w)
            start = y if side > 0 else y + w
            corner = np.array([x + side * off, start, rng.uniform(1.2, top - 0.1)])
            quads.append(
                painter.quad(corner, np.array([0, side * w, 0]), h * down, "print", rng.uniform(0.7, 0.95))
            )
    return quads


def _static(setup: _Setup) -> tuple[list[Quad], Path]:
    """The room from a tripod."""
    quads, path = _room(setup)
    start, angles = path.centre(0.0), path.angles(0.0)
    return quads, Path(centre=lambda _: start, angles=lambda _: angles, slow_start=0.0)


def _rotation(setup: _Setup) -> tuple[list[Quad], Path]:
    """The room from a tripod whose head turns about the optical centre: not a millimetre of parallax."""
    rng = setup.rng
    start = np.array([rng.uniform(-0.4, 0.4), 0.0, rng.uniform(1.2, 1.6)])
    pan = setup.sign() * rng.uniform(25, 45)
    turn_from = np.radians([-0.5 * pan, rng.uniform(-8, 0), rng.uniform(-2, 2)])
    turn_by = np.radians([pan, rng.uniform(-8, 8), rng.uniform(-4, 4)])
    jitter = Jitter.draw(rng, _HAND_DEG, 0.0)
    path = Path(lambda _: start, _turn(turn_from, turn_by), setup.slow_start, jitter=jitter)
    return _furnished_room(setup, start), path


def _rotate_then_move(setup: _Setup) -> tuple[list[Quad], Path]:
    """The turning camera of `rotation`, carried sideways once it has turned for a while."""
    quads, still = _rotation(setup)
    rng = setup.rng
    start = still.centre(0.0)
    move_from = float(rng.uniform(*_TURN_ONLY_FRAMES))
    # Sideways as seen where the turn has led by then.
    yaw = still.angles(progress(move_from, setup.slow_start))[0]
    side = setup.sign()
    sideways, ahead = side * np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([-np.sin(yaw), np.cos(yaw), 0])
    # All of the parallax has to come in half of the frames.
    along = rng.uniform(1.7, 2.1) * (sideways + rng.uniform(0, 0.3) * ahead)
    bend = np.array([0, 0, rng.uniform(-0.1, 0.1)])
    return quads, replace(still, centre=_sweep(start, along, bend), move_from=move_from)


# --- planes -----------------------------------------------------------------------------------------------------------


def _plane(
    setup: _Setup, path: Path, origin: Floats, u: Floats, v: Floats, look: str, nearest_m: float
) -> Quad:
    """One quad on the plane ``origin + a u + b v`` (u, v unit, orthogonal), large enough to fill every view."""
    corners = np.array([[x, y, 1] for x in (0, setup.width - 1) for y in (0, setup.height - 1)], float)
    rays = corners @ np.linalg.inv(setup.K).T
    spots = []
    normal = np.cross(u, v)
    for p in np.linspace(*PROGRESS_RANGE, 25):
        pose = path.steady(p, p)
        directions = rays @ pose[:3, :3].T
        reach = ((origin - pose[:3, 3]) @ normal) / (directions @ normal)
        spots.append(pose[:3, 3] + reach[:, None] * directions - origin)
    ab = np.concatenate(spots) @ np.column_stack([u, v])
    low, high = ab.min(axis=0), ab.max(axis=0)
    # Jitter is not in the steady path: a margin of 5 % is many times what it moves.
    margin = 0.05 * (high - low)
    low, high = low - margin, high + margin
    viewpoint = path.centre(0.0)
    painter = setup.painter(viewpoint, nearest_m)
    return painter.quad(
        origin + low[0] * u + low[1] * v, (high[0] - low[0]) * u, (high[1] - low[1]) * v, look
    )


def _wall(setup: _Setup) -> tuple[list[Quad], Path]:
    """One tilted wall and nothing else; a hand carries the camera in a curve."""
    rng = setup.rng
    distance = rng.uniform(1.8, 3.5)
    # Normal of the wall 12 to 32 degrees off the optical axis, in any direction but kept upright enough to be a wall.
    turned, leaning = setup.sign() * np.radians(rng.uniform(12, 30)), np.radians(rng.uniform(-10, 10))
    u = np.array([np.cos(turned), np.sin(turned), 0])
    v = np.array([-np.sin(turned) * np.sin(leaning), np.cos(turned) * np.sin(leaning), -np.cos(leaning)])
    origin = np.array([0, distance, 1.5])
    heading = rng.uniform(0, 2 * np.pi)
    reach = distance * rng.uniform(0.26, 0.36)
    # In the image plane mostly; a curve, since a straight slide along a plane is the `nadir` scene.
    along = reach * np.array([np.cos(heading), rng.uniform(-0.2, 0.35), 0.6 * np.sin(heading)])
    bend = (
        0.25
        * reach
        * setup.sign()
        * np.array([-np.sin(heading), rng.uniform(-0.3, 0.3), 0.6 * np.cos(heading)])
    )
    start = np.array([0, 0, 1.5]) - 0.5 * along
    turn_by = np.radians([rng.uniform(-8, 8), rng.uniform(-5, 5), rng.uniform(-6, 6)])
    turn_from = np.radians([rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-3, 3)])
    path = Path(
        _sweep(start, along, bend), _turn(turn_from, turn_by), setup.slow_start, jitter=_hand(setup, distance)
    )
    return [_plane(setup, path, origin, u, v, "wall", 0.75 * distance)], path


def _flight(setup: _Setup, turn_deg: float) -> tuple[list[Quad], Path]:
    """A drone over flat ground; heading and velocity turn by ``turn_deg`` in 100 frames."""
    rng = setup.rng
    height = rng.uniform(15, 35)
    reach = height * rng.uniform(0.30, 0.38)
    climb = reach * rng.uniform(0, 0.2)
    pitch = np.radians(-90 + rng.uniform(0, 30))
    # Drones fly where they look, or sideways, or backwards.
    course, yaw = rng.uniform(0, 2 * np.pi, 2)
    turn = np.radians(turn_deg)

    def centre(p: float) -> Floats:
        # An arc: the velocity turns evenly. Its limit for no turn is the straight line.
        shape = np.array([1.0, 0.0])
        if turn != 0.0:
            shape = np.array([np.sin(turn * p), 1 - np.cos(turn * p)]) / turn
            flat = (
                np.array([np.cos(course), np.sin(course)]) * shape[0]
                + np.array([-np.sin(course), np.cos(course)]) * shape[1]
            )
        else:
            flat = p * np.array([np.cos(course), np.sin(course)])
        return np.array([*(reach * flat), height + climb * p])

    roll = np.radians(rng.uniform(-2, 2))
    angles = _turn(np.array([yaw, pitch, roll]), np.array([turn, 0, 0]))
    jitter = Jitter.draw(rng, _GIMBAL_DEG, _GIMBAL_M)
    path = Path(centre, angles, setup.slow_start, jitter=jitter)
    u, v = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([np.sin(yaw), -np.cos(yaw), 0])
    return [_plane(setup, path, np.zeros(3), u, v, "ground", 0.9 * height)], path


def _nadir(setup: _Setup) -> tuple[list[Quad], Path]:
    """Straight flight over flat ground: two poses explain it, and later views do not decide."""
    return _flight(setup, 0.0)


def _nadir_turn(setup: _Setup) -> tuple[list[Quad], Path]:
    """The same ground in a turn: later views decide between the two poses."""
    return _flight(setup, setup.sign() * float(setup.rng.uniform(45, 90)))


# --- corridor and desk ------------------------------------------------------------------------------------------------


def _corridor(setup: _Setup) -> tuple[list[Quad], Path]:
    """Walking down a corridor."""
    rng = setup.rng
    half, top, length = rng.uniform(1.0, 1.4), rng.uniform(2.3, 2.7), rng.uniform(14, 20)
    start = np.array([rng.uniform(-0.25, 0.25) * half, 0.0, rng.uniform(1.2, 1.6)])
    along = np.array([rng.uniform(-0.08, 0.08), rng.uniform(1.5, 1.9), rng.uniform(-0.05, 0.05)])
    turn_from = np.radians([rng.uniform(-3, 3), rng.uniform(-5, 0), rng.uniform(-1, 1)])
    turn_by = np.radians([rng.uniform(-4, 4), rng.uniform(-2, 2), rng.uniform(-2, 2)])
    path = Path(
        _sweep(start, along, np.zeros(3)),
        _turn(turn_from, turn_by),
        setup.slow_start,
        jitter=_hand(setup, 2.0),
    )
    painter = setup.painter(start, 1.4)
    quads = _corridor_walls(painter, rng, half, top, length)
    for _ in range(int(rng.integers(6, 10))):
        side = setup.sign()
        size = np.array([rng.uniform(0.25, 0.5), rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.4)])
        centre = np.array([side * (half - 0.5 * size[0]), rng.uniform(3.4, 0.8 * length), 0])
        quads += box(painter, centre, size, 0.0, str(rng.choice(["print", "wood"])))
    return quads, path


def _corridor_walls(
    painter: Painter, rng: np.random.Generator, half: float, top: float, length: float
) -> list[Quad]:
    """Walls, floor and ceiling in panels, each as fine as its distance asks; door frames between some of them."""
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


def _desk(setup: _Setup) -> tuple[list[Quad], Path]:
    """A desk top that fills most of the view, with boxes on it; a hand carries the camera over it."""
    rng = setup.rng
    desk_z = 0.75
    pitch = np.radians(-rng.uniform(42, 55))
    distance = rng.uniform(0.85, 1.15)
    # Look at the middle of the desk from its near side.
    middle = np.array([0, 0, desk_z])
    start = middle + distance * np.array([0, -np.cos(pitch), -np.sin(pitch)])
    side = setup.sign()
    along = (
        distance * rng.uniform(0.27, 0.36) * np.array([side, rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)])
    )
    bend = distance * np.array([0, rng.uniform(-0.06, 0.06), rng.uniform(-0.05, 0.05)])
    turn_from = np.array([-side * np.radians(rng.uniform(-4, 4)), pitch, np.radians(rng.uniform(-4, 4))])
    turn_by = np.radians([side * rng.uniform(2, 14), rng.uniform(-3, 3), rng.uniform(-5, 5)])
    start = start - 0.5 * along
    path = Path(
        _sweep(start, along, bend), _turn(turn_from, turn_by), setup.slow_start, jitter=_hand(setup, 1.0)
    )
    painter = setup.painter(start, 0.6)
    wide, deep = rng.uniform(1.0, 1.3), rng.uniform(0.75, 0.95)
    quads = [
        painter.quad(
            np.array([-wide, deep, desk_z]),
            np.array([2 * wide, 0, 0]),
            np.array([0, -deep - 0.7, 0]),
            "desk",
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


# --- moving objects ---------------------------------------------------------------------------------------------------


def _moving_cards(setup: _Setup, path: Path, quads: list[Quad], share: float) -> list[Quad]:
    """Boards that drift to and fro before the camera and together cover about a share of the image.

    They follow the camera's steady path, so that they stay in view, and sway on their own.
    """
    rng = setup.rng
    pose = path.steady(0.0, 0.0)
    right, down, ahead = pose[:3, 0], pose[:3, 1], pose[:3, 2]
    # Clearly nearer than the scene, so that they are never inside of it.
    distance = 0.6 * _nearest_ahead(setup, quads, pose)
    view_w, view_h = distance * setup.width / setup.K[0, 0], distance * setup.height / setup.K[1, 1]
    count = 3
    painter = setup.painter(pose[:3, 3], distance)
    painter.count = len(quads)
    cards = []
    for i in range(count):
        w, h = view_w * np.sqrt(share / count), view_h * np.sqrt(share / count)
        x = view_w * ((i + 0.5) / count - 0.5)
        y = rng.uniform(-0.5, 0.5) * (view_h - h)
        corner = (
            pose[:3, 3] + (1 - 0.05 * i) * distance * ahead + (x - 0.5 * w) * right + (y - 0.5 * h) * down
        )
        sway, rate, phase = 0.12 * view_w * setup.sign(), rng.uniform(0.05, 0.09), rng.uniform(0, 2 * np.pi)

        def displacement(
            frame: float, sway: float = sway, rate: float = rate, phase: float = phase
        ) -> Floats:
            moved = progress(frame - path.move_from, path.slow_start)
            carried = path.centre(moved) - path.centre(0.0)
            return np.asarray(
                carried
                + sway * (np.sin(phase + rate * frame) * right + 0.4 * np.cos(phase + rate * frame) * down)
            )

        cards.append(painter.quad(corner, w * right, h * down, "print", displacement=displacement))
    return cards


def _nearest_ahead(setup: _Setup, quads: list[Quad], pose: Floats) -> float:
    """Least depth among rays spread over the view."""
    x, y = np.meshgrid(np.linspace(0, setup.width - 1, 7), np.linspace(0, setup.height - 1, 7))
    rays = pose[:3, :3] @ np.linalg.inv(setup.K) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    depths = []
    for quad in quads:
        edges = np.column_stack([quad.edge_u, quad.edge_v])
        normal = np.cross(*edges.T)
        depth = (normal @ (quad.corner - pose[:3, 3])) / (normal @ rays)
        a, b = np.linalg.pinv(edges) @ (pose[:3, 3:] + depth * rays - quad.corner[:, None])
        depths.append(depth[(depth > 0) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)])
    return float(np.concatenate(depths).min())


_BUILDERS: dict[str, Callable[[_Setup], tuple[list[Quad], Path]]] = {
    "room": _room,
    "wall": _wall,
    "nadir": _nadir,
    "nadir-turn": _nadir_turn,
    "corridor": _corridor,
    "desk": _desk,
    "rotation": _rotation,
    "rotate-then-move": _rotate_then_move,
    "static": _static,
}

SCENES: tuple[str, ...] = tuple(_BUILDERS)
