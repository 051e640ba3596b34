"""The scenes by name: their surfaces, and the path of the camera.

Sizes are in metres; the z axis of the world points up. Each builder draws the path and keeps objects away from it.

Scenes indoors are ``room``, ``static``, ``rotation`` and ``rotate-then-move`` in a furnished room, ``corridor`` and
``desk``. ``wall``, ``nadir``, ``nadir-turn``, ``tilted-15``, ``tilted-30`` and ``tilted-45`` are one plane. In
``handheld``, ``handheld-wall`` and ``pan`` the camera is handled in seconds and not in frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.options import SynthOptions
from sequences_synth.surfaces import Painter, Setup, box, corridor_walls, furnished_room
from sequences_synth.texture import Quad
from sequences_synth.trajectory import (
    BEND_RAD_S,
    PROGRESS_RANGE,
    Handling,
    Path,
    arc,
    draw_tremor,
    draw_turning,
    orientation,
    progress,
    rotation_from_vector,
)

#: What a builder makes of its input: the surfaces, and frame number -> pose world_from_cam (4, 4), metres.
Built: TypeAlias = tuple[list[Quad], Callable[[float], Floats]]

# -- indoors ---------------------------------------------------------------------------------------


# A hand trembles by a fraction of a degree and some millimetres.
_HAND_DEG, _HAND_M = 0.25, 0.004
# Range of the frame at which the translation of `rotate-then-move` starts.
_FIRST_TRANSLATION_FRAME = (40.0, 50.0)


def _carried(
    setup: Setup, start: Floats, along: Floats, bend: Floats, turn_from: Floats, turn_by: Floats, distance_m: float
) -> Path:
    """A path ``start + p along + p^2 bend`` of the progress p, with angles that are linear in it, carried by hand.

    The position trembles less when the scene is near, as people then move with care.

    * ``distance_m``: Distance to the scene; below 2 m the tremor of the position shrinks in proportion.
    """
    tremor = draw_tremor(setup.rng, _HAND_DEG, _HAND_M * min(1.0, distance_m / 2))
    slow_start = setup.options.slow_start
    return Path(
        lambda p: start + p * along + p * p * bend, lambda p: turn_from + p * turn_by, slow_start, tremor=tremor
    )


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
    path = _carried(setup, start, along, bend, turn_from, turn_by, 3.0)
    return furnished_room(setup, start), path


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
    tremor = draw_tremor(rng, _HAND_DEG, 0.0)
    path = Path(lambda _: start, lambda p: turn_from + p * turn_by, setup.options.slow_start, tremor=tremor)
    return furnished_room(setup, start), path


def rotate_then_move(setup: Setup) -> tuple[list[Quad], Path]:
    """Build the scene `rotation` in which the camera starts to move sideways after 40 to 50 frames."""
    quads, rotating = rotation(setup)
    rng = setup.rng
    start = rotating.centre(0.0)
    move_from = float(rng.uniform(*_FIRST_TRANSLATION_FRAME))
    # Sideways with respect to the heading at the frame at which the translation starts.
    yaw = rotating.angles(progress(move_from, setup.options.slow_start))[0]
    side = setup.random_sign()
    sideways, ahead = side * np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([-np.sin(yaw), np.cos(yaw), 0])
    # The whole translation has to fit into half of the frames.
    along = rng.uniform(1.7, 2.1) * (sideways + rng.uniform(0, 0.3) * ahead)
    bend = np.array([0, 0, rng.uniform(-0.1, 0.1)])
    return quads, replace(rotating, centre=lambda p: start + p * along + p * p * bend, move_from=move_from)


def corridor(setup: Setup) -> tuple[list[Quad], Path]:
    """Build a corridor through which the camera is carried forwards."""
    rng = setup.rng
    half, top, length = rng.uniform(1.0, 1.4), rng.uniform(2.3, 2.7), rng.uniform(14, 20)
    start = np.array([rng.uniform(-0.25, 0.25) * half, 0.0, rng.uniform(1.2, 1.6)])
    along = np.array([rng.uniform(-0.08, 0.08), rng.uniform(1.5, 1.9), rng.uniform(-0.05, 0.05)])
    turn_from = np.radians([rng.uniform(-3, 3), rng.uniform(-5, 0), rng.uniform(-1, 1)])
    turn_by = np.radians([rng.uniform(-4, 4), rng.uniform(-2, 2), rng.uniform(-2, 2)])
    path = _carried(setup, start, along, np.zeros(3), turn_from, turn_by, 2.0)
    painter = Painter(setup, start, 1.4)
    quads = corridor_walls(painter, rng, half, top, length)
    for _ in range(int(rng.integers(6, 10))):
        side = setup.random_sign()
        size = np.array([rng.uniform(0.25, 0.5), rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.4)])
        place = np.array([side * (half - 0.5 * size[0]), rng.uniform(3.4, 0.8 * length), 0])
        quads += box(painter, place, size, 0.0, str(rng.choice(["print", "wood"])))
    return quads, path


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
    path = _carried(setup, start, along, bend, turn_from, turn_by, 1.0)
    painter = Painter(setup, start, 0.6)
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


# -- planes ----------------------------------------------------------------------------------------


# A gimbal trembles less than a hand (degrees), but the wind moves the drone (metres).
_GIMBAL_DEG, _GIMBAL_M = 0.08, 0.03


def _plane(setup: Setup, path: Path, origin: Floats, u: Floats, v: Floats, look: str, nearest_m: float) -> Quad:
    """One quad on the plane ``origin + a u + b v`` (u, v orthonormal), large enough to fill every view."""
    poses = [path.steady(p, p) for p in np.linspace(*PROGRESS_RANGE, 25)]
    low, high = _extent(setup, poses, origin, u, v, np.cross(u, v))
    # The steady path has no tremor. A margin of 5 % is many times the displacement by the tremor.
    margin = 0.05 * (high - low)
    return _part_of_plane(Painter(setup, path.centre(0.0), nearest_m), origin, u, v, low - margin, high + margin, look)


def _extent(
    setup: Setup, poses: list[Floats], origin: Floats, u: Floats, v: Floats, normal: Floats
) -> tuple[Floats, Floats]:
    """The least and the largest coordinates (a, b) on the plane ``origin + a u + b v`` that corners of views see."""
    corners = np.array([[x, y, 1] for x in (0, setup.options.width - 1) for y in (0, setup.options.height - 1)], float)
    rays = corners @ np.linalg.inv(setup.K).T
    spots = []
    for pose in poses:
        directions = rays @ pose[:3, :3].T
        reach = ((origin - pose[:3, 3]) @ normal) / (directions @ normal)
        spots.append(pose[:3, 3] + reach[:, None] * directions - origin)
    ab = np.concatenate(spots) @ np.column_stack([u, v])
    return ab.min(axis=0), ab.max(axis=0)


def _part_of_plane(
    painter: Painter, origin: Floats, u: Floats, v: Floats, low: Floats, high: Floats, look: str
) -> Quad:
    return painter.quad(origin + low[0] * u + low[1] * v, (high[0] - low[0]) * u, (high[1] - low[1]) * v, look)


def wall(setup: Setup) -> tuple[list[Quad], Path]:
    """Build one tilted wall and nothing else; the camera is held by hand and moves in a curve."""
    rng = setup.rng
    distance = rng.uniform(1.8, 3.5)
    # The normal of the wall is 12 to 32 degrees off the optical axis. The wall leans by 10 degrees at most.
    turned, leaning = setup.random_sign() * np.radians(rng.uniform(12, 30)), np.radians(rng.uniform(-10, 10))
    u = np.array([np.cos(turned), np.sin(turned), 0])
    v = np.array([-np.sin(turned) * np.sin(leaning), np.cos(turned) * np.sin(leaning), -np.cos(leaning)])
    origin = np.array([0, distance, 1.5])
    heading = rng.uniform(0, 2 * np.pi)
    reach = distance * rng.uniform(0.26, 0.36)
    # The motion is mostly parallel to the image. The path is curved: a straight path along a plane is scene `nadir`.
    along = reach * np.array([np.cos(heading), rng.uniform(-0.2, 0.35), 0.6 * np.sin(heading)])
    side = setup.random_sign()
    bend = 0.25 * reach * side * np.array([-np.sin(heading), rng.uniform(-0.3, 0.3), 0.6 * np.cos(heading)])
    start = np.array([0, 0, 1.5]) - 0.5 * along
    turn_by = np.radians([rng.uniform(-8, 8), rng.uniform(-5, 5), rng.uniform(-6, 6)])
    turn_from = np.radians([rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-3, 3)])
    path = _carried(setup, start, along, bend, turn_from, turn_by, distance)
    return [_plane(setup, path, origin, u, v, "wall", 0.75 * distance)], path


def flight(setup: Setup, turn_deg: float = 0.0, tilt_deg: float | None = None) -> Built:
    """Build the flight of a drone over flat ground; heading and velocity turn by ``turn_deg`` in 100 frames.

    Two poses explain the views of a straight flight, and later views do not decide; in a turn they do. By default the
    drone climbs a little, and the camera is 0 to 30 degrees off the vertical in any direction. With ``tilt_deg`` the
    flight is level, and the camera is tilted by this angle from the vertical, along or across the direction of flight.
    """
    rng = setup.rng
    height = rng.uniform(15, 35)
    reach = height * rng.uniform(0.30, 0.38)
    climb = reach * rng.uniform(0, 0.2)
    pitch = np.radians(-90 + rng.uniform(0, 30))
    # The direction of flight is independent of the heading: a drone can fly sideways and backwards.
    course, yaw = rng.uniform(0, 2 * np.pi, 2)
    turn = np.radians(turn_deg)
    if tilt_deg is not None:
        # The camera is tilted forward in half of the worlds, and to the left or right in the others. A yaw of 0 looks
        # along the y axis, a course of 0 leads along the x axis.
        climb, pitch = 0.0, np.radians(-90 + tilt_deg)
        yaw = course + np.pi / 2 * (rng.choice([0.0, setup.random_sign()]) - 1)

    def centre(p: float) -> Floats:
        # An arc: the direction of the velocity is linear in p. np.sinc avoids 0 / 0 in the limit of a straight line.
        ahead = p * np.sinc(turn * p / np.pi)
        aside = 0.5 * turn * p * p * np.sinc(0.5 * turn * p / np.pi) ** 2
        c, s = np.cos(course), np.sin(course)
        flat = np.array([c * ahead - s * aside, s * ahead + c * aside])
        return np.array([*(reach * flat), height + climb * p])

    roll = np.radians(rng.uniform(-2, 2))
    turn_from, turn_by = np.array([yaw, pitch, roll]), np.array([turn, 0, 0])
    tremor = draw_tremor(rng, _GIMBAL_DEG, _GIMBAL_M)
    path = Path(centre, lambda p: turn_from + p * turn_by, setup.options.slow_start, tremor=tremor)
    u, v = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([np.sin(yaw), -np.cos(yaw), 0])
    return [_plane(setup, path, np.zeros(3), u, v, "ground", 0.9 * height)], path


def nadir_turn(setup: Setup) -> Built:
    """Build a flight in a turn over flat ground."""
    return flight(setup, setup.random_sign() * float(setup.rng.uniform(45, 90)))


# -- hand-held -------------------------------------------------------------------------------------


# Median depth of the furnished room, metres: the unit of the speed of the translation.
_ROOM_DEPTH_M = 3.0
# The camera moves along a circle of at most this radius. The room has no object nearer than 1.3 m.
_LARGEST_RADIUS_M = 0.4
# Range of the distance of the wall, metres; largest angle between its normal and the axis about which the camera
# oscillates; and largest tilt of the optical axis from that axis.
_WALL_M, _WALL_DEG, _WALL_TILT_DEG = (1.2, 3.5), 12.0, 15.0
# The angular speed of hand-held turning is a root mean square over this time. It does not depend on the number of
# frames, so that a longer sequence continues the path of a shorter one.
_HANDLING_S = 10.0
# The wall fills the views of this many seconds.
_WALL_S = 120.0


def _held(
    setup: Setup, start: Floats, turning: Callable[[Floats], Floats], position: Callable[[Floats], Floats]
) -> Callable[[float], Floats]:
    """Frame number -> pose of a camera that is turned by hand, or steadily.

    Shapes: ``start`` (4, 4).

    * ``start``: Pose about which the camera is turned.
    * ``turning, position``: Time in seconds -> rotation vector and translation, in the axes of ``start``.
    """

    def world_from_cam(frame: float) -> Floats:
        time_s = np.array(frame / setup.options.fps)
        pose = start.copy()
        pose[:3, :3] = pose[:3, :3] @ rotation_from_vector(turning(time_s))
        pose[:3, 3] += start[:3, :3] @ position(time_s)
        return pose

    return world_from_cam


def _turning(setup: Setup, largest_tilt_deg: float = np.inf) -> Callable[[Floats], Floats]:
    """A turning by hand, of which the angular speed does not depend on the number of frames."""
    handling = Handling(_HANDLING_S, setup.options.turning_deg_s, setup.options.speed)
    return draw_turning(setup.rng, handling, largest_tilt_deg)


def _arc(setup: Setup, along: Floats, across: Floats, depth_m: float) -> Callable[[Floats], Floats]:
    """An arc that bends enough to stay within the largest radius."""
    speed = setup.options.speed
    bend_rad_s = max(float(setup.rng.uniform(*BEND_RAD_S)), speed * depth_m / _LARGEST_RADIUS_M)
    position = arc(speed, bend_rad_s, along, across)
    return lambda time_s: depth_m * position(time_s)


def _stand(rng: np.random.Generator, pitch_deg: float) -> Floats:
    """Pose of a standing person who looks along y, and up or down by at most the pitch."""
    pose = np.eye(4)
    pose[:3, :3] = orientation(0.0, np.radians(rng.uniform(-pitch_deg, pitch_deg)))
    pose[:3, 3] = rng.uniform(-0.4, 0.4), 0.0, rng.uniform(1.2, 1.6)
    return pose


def handheld(setup: Setup) -> Built:
    """Build the furnished room, seen by a camera that is turned by hand and moves little or not at all."""
    start = _stand(setup.rng, 5.0)
    turning = _turning(setup)
    # Sideways, and then backwards: the furniture stands ahead.
    side = setup.random_sign()
    position = _arc(setup, np.array([side, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]), _ROOM_DEPTH_M)
    return furnished_room(setup, start[:3, 3]), _held(setup, start, turning, position)


def pan(setup: Setup) -> Built:
    """Build the furnished room, seen by a camera that turns steadily about the vertical axis and never translates."""
    start = _stand(setup.rng, 0.0)
    # The y axis of the camera points down.
    rate_rad_s = np.radians(setup.options.turning_deg_s) * np.array([0.0, setup.random_sign(), 0.0])
    path = _held(setup, start, lambda time_s: time_s * rate_rad_s, lambda _: np.zeros(3))
    return furnished_room(setup, start[:3, 3]), path


def handheld_wall(setup: Setup) -> Built:
    """Build one wall, seen by a hand-held camera that oscillates about an axis that points to the wall."""
    rng = setup.rng
    start = _stand(rng, 0.0)
    turning = _turning(setup, _WALL_TILT_DEG)
    distance = rng.uniform(*_WALL_M)
    axis = rng.uniform(0, 2 * np.pi)
    leaning = np.radians(rng.uniform(3.0, _WALL_DEG)) * np.array([np.cos(axis), np.sin(axis), 0.0])
    right, down, normal = (start[:3, :3] @ rotation_from_vector(leaning)).T
    heading = rng.uniform(0, 2 * np.pi)
    in_cam = start[:3, :3].T
    along = in_cam @ (np.cos(heading) * right + np.sin(heading) * down)
    across = in_cam @ (np.cos(heading) * down - np.sin(heading) * right)
    path = _held(setup, start, turning, _arc(setup, along, across, distance))
    # The quad holds every point of the wall that the corners of a view meet.
    origin = start[:3, 3] + distance * start[:3, 2]
    poses = [path(float(frame)) for frame in np.linspace(0, _WALL_S * setup.options.fps, 1500)]
    low, high = _extent(setup, poses, origin, right, down, normal)
    # A lens with a barrel distortion and the gaps between the instants need some more.
    painter = Painter(setup, start[:3, 3], 0.8 * distance)
    return [_part_of_plane(painter, origin, right, down, 1.35 * low, 1.35 * high, "wall")], path


# -- all -------------------------------------------------------------------------------------------


def build_world(
    name: str, entropy: tuple[int, ...], K: Floats, options: SynthOptions
) -> tuple[list[Quad], Callable[[float], Floats], tuple[float, float]]:
    """Build a scene.

    Shapes: ``K`` (3, 3).

    * Returns: Its surfaces; frame number, not necessarily whole -> pose (4, 4) of the camera; and of the slow sine of
      the exposure the phase at frame 0 and the advance per frame, radians.
    """
    rng = np.random.default_rng(entropy)
    quads, world_from_cam = _BUILDERS[name](Setup(rng, entropy, K, options))
    return quads, world_from_cam, (float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.03, 0.09)))


_BUILDERS: dict[str, Callable[[Setup], Built]] = {
    "room": room,
    "wall": wall,
    "nadir": flight,
    "nadir-turn": nadir_turn,
    "corridor": corridor,
    "desk": desk,
    "rotation": rotation,
    "rotate-then-move": rotate_then_move,
    "static": static,
    "tilted-15": partial(flight, tilt_deg=15.0),
    "tilted-30": partial(flight, tilt_deg=30.0),
    "tilted-45": partial(flight, tilt_deg=45.0),
    "handheld": handheld,
    "handheld-wall": handheld_wall,
    "pan": pan,
}

#: Names of the rendered scenes.
SCENES: tuple[str, ...] = tuple(_BUILDERS)
#: Scenes that grids and benchmarks draw by default, rendered or as points. This list is fixed, so that measured tables
#: stay comparable when scenes are added. Other scenes are reached by name.
STANDARD_SCENES: tuple[str, ...] = SCENES[:9]
