"""Add a data set in 20 lines: a class that yields frames, and knows the camera and the true path.

Nothing has to be registered. Every command takes it by its import path: ::

    slam-init run python:slam_init.examples.add_a_data_set:Poster
    slam-init compare python:slam_init.examples.add_a_data_set:Poster --methods quest,poselib

This one is a poster on a wall, seen by a camera that slides past it and turns a little: a homography for each frame.
Where your data lie in files, read them in ``frames``; ``camera`` and ``groundtruth`` may be None for ``slam-init run``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Pose, Trajectory

__all__ = ["Poster"]


@dataclass(frozen=True)
class Poster:
    """A :class:`slam_init.datasets.timed.TimedSource`."""

    name: str = "poster"
    kind: str = "example"
    camera: Camera = field(default_factory=lambda: Camera("pinhole", 320, 240, 260.0, 260.0, 159.5, 119.5))
    length: int = 40

    def __len__(self) -> int:
        return self.length

    @property
    def timestamps_s(self) -> Floats:
        """(N,) float: 30 frames a second."""
        return np.arange(self.length) / 30.0

    @property
    def groundtruth(self) -> Trajectory:
        """The camera slides to the right in a curve, a metre from the wall z = 1."""
        s = np.arange(self.length) / self.length
        poses = (Pose(rotation_from_vector(np.array([0.1 * a, -0.2 * a, 0])), np.array([a, a * a, 0]) / 2) for a in s)
        return Trajectory(self.timestamps_s, tuple(poses))

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Yield frames in order from an index on."""
        import cv2

        noise = np.random.default_rng(0).normal(size=(600, 800))
        poster = np.clip(128 + 400 * cv2.GaussianBlur(noise, (0, 0), 2.5), 0, 255).astype(np.uint8)
        metres_from_poster = np.array([[1 / 300, 0, -1.0], [0, 1 / 300, -0.8], [0, 0, 1]])  # on the wall, z = 1
        size = (self.camera.width, self.camera.height)
        for index in range(self.length)[start : None if max_frames is None else start + max_frames]:
            cam_from_world = self.groundtruth.world_from_cam[index].inverse()
            cam_from_wall = cam_from_world.R + np.outer(cam_from_world.t, [0, 0, 1])
            image = cv2.warpPerspective(poster, self.camera.K @ cam_from_wall @ metres_from_poster, size)
            yield Frame(index, index / 30.0, f"{index:03d}", np.asarray(image, np.uint8))
