"""Scenes whose camera is handled in seconds and not in frames: `handheld`, `handheld-wall`, `pan`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.builder import Setup
from sequences_synth.room_scenes import furnished_room
from sequences_synth.textured_quad import Quad
from sequences_synth.trajectory import Arc, HandTurning, orientation, rotation_from_vector

# Median depth of the furnished room, metres: the unit of the speed of the translation.
_ROOM_DEPTH_M = 3.0
# The camera moves along a circle of at most this radius. The room has no object nearer than 1.3 m.
_LARGEST_RADIUS_M = 0.4
# Range of the distance of the wall, metres; largest angle between its normal and the axis about which the camera
# oscillates; and largest tilt of the optical axis from that axis.
_WALL_M, _WALL_DEG, _WALL_TILT_DEG = (1.2, 3.5), 12.0, 15.0
# The wall fills the views of this many seconds.
_WALL_S = 120.0


@dataclass(frozen=True, eq=False)
class HandPath:
    """The path of a camera that is turned by hand, or steadily."""

    #: Frames per second.
    fps: float
    #: (4, 4) Pose world_from_cam about which the camera is turned, metres.
    start: Floats
    #: Time (N,) in seconds -> rotation vector (N, 3), radians.
    turning: Callable[[Floats], Floats]
    #: Translation in the axes of ``start``.
    arc: Arc
    #: Unit of the arc.
    depth_m: float

    def world_from_cam(self, frame: float) -> Floats:
        """Compute the pose at a frame.

        Shapes: returns (4, 4).
        """
        time_s = np.array(frame / self.fps)
        pose = self.start.copy()
        pose[:3, :3] = pose[:3, :3] @ rotation_from_vector(self.turning(time_s))
        pose[:3, 3] += self.start[:3, :3] @ (self.depth_m * self.arc.position(time_s))
        return pose


def _arc(setup: Setup, along: Floats, across: Floats, depth_m: float) -> Arc:
    """An arc that bends enough to stay within the largest radius."""
    drawn = Arc.draw(setup.rng, setup.handling, along, across)
    least = setup.handling.speed * depth_m / _LARGEST_RADIUS_M
    return Arc(drawn.speed, max(drawn.bend_rad_s, least), along, across)


def _stand(rng: np.random.Generator, pitch_deg: float) -> Floats:
    """Pose of a standing person who looks along y, and up or down by at most the pitch."""
    pose = np.eye(4)
    pose[:3, :3] = orientation(0.0, np.radians(rng.uniform(-pitch_deg, pitch_deg)))
    pose[:3, 3] = rng.uniform(-0.4, 0.4), 0.0, rng.uniform(1.2, 1.6)
    return pose


def handheld(setup: Setup) -> tuple[list[Quad], HandPath]:
    """Build the furnished room, seen by a camera that is turned by hand and moves little or not at all."""
    start = _stand(setup.rng, 5.0)
    turning = HandTurning.draw(setup.rng, setup.handling)
    # Sideways, and then backwards: the furniture stands ahead.
    side = setup.random_sign()
    path = HandPath(
        setup.fps,
        start,
        turning.rotation_vector,
        _arc(setup, np.array([side, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]), _ROOM_DEPTH_M),
        _ROOM_DEPTH_M,
    )
    return furnished_room(setup, start[:3, 3]), path


def pan(setup: Setup) -> tuple[list[Quad], HandPath]:
    """Build the furnished room, seen by a camera that turns steadily about the vertical axis and never translates."""
    start = _stand(setup.rng, 0.0)
    # The y axis of the camera points down.
    rate_rad_s = np.radians(setup.handling.turning_deg_s) * np.array([0.0, setup.random_sign(), 0.0])
    still = Arc(0.0, 1.0, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    path = HandPath(setup.fps, start, lambda time_s: time_s[..., None] * rate_rad_s, still, _ROOM_DEPTH_M)
    return furnished_room(setup, start[:3, 3]), path


def handheld_wall(setup: Setup) -> tuple[list[Quad], HandPath]:
    """Build one wall, seen by a hand-held camera that oscillates about an axis that points to the wall."""
    rng = setup.rng
    start = _stand(rng, 0.0)
    turning = HandTurning.draw(rng, setup.handling, _WALL_TILT_DEG)
    distance = rng.uniform(*_WALL_M)
    axis = rng.uniform(0, 2 * np.pi)
    leaning = np.radians(rng.uniform(3.0, _WALL_DEG)) * np.array([np.cos(axis), np.sin(axis), 0.0])
    right, down, normal = (start[:3, :3] @ rotation_from_vector(leaning)).T
    heading = rng.uniform(0, 2 * np.pi)
    in_cam = start[:3, :3].T
    along = in_cam @ (np.cos(heading) * right + np.sin(heading) * down)
    across = in_cam @ (np.cos(heading) * down - np.sin(heading) * right)
    path = HandPath(setup.fps, start, turning.rotation_vector, _arc(setup, along, across, distance), distance)
    # The quad holds every point of the wall that the corners of a view meet.
    corners = np.array([[x, y, 1] for x in (0, setup.width - 1) for y in (0, setup.height - 1)], float)
    rays = corners @ np.linalg.inv(setup.K).T
    origin = start[:3, 3] + distance * start[:3, 2]
    spots = []
    for frame in np.linspace(0, _WALL_S * setup.fps, 1500):
        pose = path.world_from_cam(float(frame))
        directions = rays @ pose[:3, :3].T
        reach = ((origin - pose[:3, 3]) @ normal) / (directions @ normal)
        spots.append(pose[:3, 3] + reach[:, None] * directions - origin)
    ab = np.concatenate(spots) @ np.column_stack([right, down])
    # A lens with a barrel distortion, the margin of a stabilizer and the gaps between the instants need some more.
    low, high = 1.35 * ab.min(axis=0), 1.35 * ab.max(axis=0)
    painter = setup.painter(start[:3, 3], 0.8 * distance)
    corner = origin + low[0] * right + low[1] * down
    return [painter.quad(corner, (high[0] - low[0]) * right, (high[1] - low[1]) * down, "wall")], path
