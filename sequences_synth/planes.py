"""Scenes that are one plane: `wall`, `nadir`, `nadir-turn`, `tilted-15`, `tilted-30`, `tilted-45`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.builder import Setup, curved_path, hand_jitter, linear_angles
from sequences_synth.textured_quad import Quad
from sequences_synth.trajectory import PROGRESS_RANGE, Jitter, Path

# A gimbal trembles less than a hand (degrees), but the wind moves the drone (metres).
_GIMBAL_DEG, _GIMBAL_M = 0.08, 0.03


def _plane(setup: Setup, path: Path, origin: Floats, u: Floats, v: Floats, look: str, nearest_m: float) -> Quad:
    """One quad on the plane ``origin + a u + b v`` (u, v orthonormal), large enough to fill every view."""
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
    # The steady path has no jitter. A margin of 5 % is many times the displacement by the jitter.
    margin = 0.05 * (high - low)
    low, high = low - margin, high + margin
    viewpoint = path.centre(0.0)
    painter = setup.painter(viewpoint, nearest_m)
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
    centre, angles = curved_path(start, along, bend), linear_angles(turn_from, turn_by)
    path = Path(centre, angles, setup.slow_start, jitter=hand_jitter(setup, distance))
    return [_plane(setup, path, origin, u, v, "wall", 0.75 * distance)], path


def _flight(setup: Setup, turn_deg: float, tilt_deg: float | None = None) -> tuple[list[Quad], Path]:
    """A drone over flat ground; heading and velocity turn by ``turn_deg`` in 100 frames.

    By default the drone climbs a little, and the camera is 0 to 30 degrees off the vertical in any direction. With
    ``tilt_deg`` the flight is level, and the camera is tilted by this angle from the vertical, along or across the
    direction of flight.
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
    angles = linear_angles(np.array([yaw, pitch, roll]), np.array([turn, 0, 0]))
    jitter = Jitter.draw(rng, _GIMBAL_DEG, _GIMBAL_M)
    path = Path(centre, angles, setup.slow_start, jitter=jitter)
    u, v = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([np.sin(yaw), -np.cos(yaw), 0])
    return [_plane(setup, path, np.zeros(3), u, v, "ground", 0.9 * height)], path


def nadir(setup: Setup) -> tuple[list[Quad], Path]:
    """Build a straight flight over flat ground. Two poses explain its views, and later views do not decide."""
    return _flight(setup, 0.0)


def nadir_turn(setup: Setup) -> tuple[list[Quad], Path]:
    """Build a flight in a turn over flat ground. Later views decide between the two poses."""
    return _flight(setup, setup.random_sign() * float(setup.rng.uniform(45, 90)))


def tilted(tilt_deg: float) -> Callable[[Setup], tuple[list[Quad], Path]]:
    """Make the builder of a straight level flight over flat ground with a tilted camera.

    * ``tilt_deg``: Angle between the optical axis and the normal of the ground. The camera is tilted forward in half of
      the worlds, and to the left or right in the others.
    * Returns: Setup -> the one quad of the ground, as a list, and the path.
    """
    return lambda setup: _flight(setup, 0.0, tilt_deg)
