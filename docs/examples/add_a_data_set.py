"""Add a data set: a class that yields frames and knows the camera and the true trajectory, and a reader of its folders.

The class need not be registered. Every command accepts its import path: ::

    slam-init run python:docs/examples/add_a_data_set.py:Poster
    slam-init compare python:docs/examples/add_a_data_set.py:Poster --methods quest,poselib

The example shows a poster on a wall. The camera slides past the poster and rotates a little, so each frame is a
homography of the poster. For ``slam-init run``, ``camera`` and ``groundtruth`` may be None.

If your data are folders, write a reader: a :class:`~slam_init.datasets.posed_images.Layout` recognizes a folder of this
kind and opens it. An installed package announces it by an entry point: ::

    [project.entry-points."slam_init.readers"]
    poster = "add_a_data_set:LAYOUT"

Then every command opens such a folder by its path. Readers of packages are asked before those of slam-init. A folder of
images with time stamps, a calibration and true poses needs no class of its own: call
:func:`~slam_init.datasets.posed_images.image_sequence`, which checks them and makes the source.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets.image_files import read_image
from slam_init.datasets.posed_images import Layout, file_of
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Pose, Trajectory


@dataclass(frozen=True)
class Poster:
    """A data set that implements :class:`slam_init.types.frame.TimedSource`."""

    name: str = "poster"
    #: Kind of the source in ``summary.json``.
    kind: str = "poster"
    camera: Camera = field(default_factory=lambda: Camera("pinhole", 320, 240, 260.0, 260.0, 159.5, 119.5))
    #: Number of frames.
    length: int = 40
    #: The picture on the wall; without one it is noise.
    picture: Path | None = None

    def __len__(self) -> int:
        return self.length

    @property
    def timestamps_s(self) -> Floats:
        """Time stamps of the frames: 30 frames per second.

        Shapes: returns (N,).
        """
        return np.arange(self.length) / 30.0

    @property
    def groundtruth(self) -> Trajectory:
        """True trajectory: the camera slides to the right in a curve, one metre away from the wall z = 1."""
        s = np.arange(self.length) / self.length
        poses = (Pose(rotation_from_vector(np.array([0.1 * a, -0.2 * a, 0])), np.array([a, a * a, 0]) / 2) for a in s)
        return Trajectory(self.timestamps_s, tuple(poses))

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Render frames."""
        import cv2

        if self.picture is None:
            noise = np.random.default_rng(0).normal(size=(600, 800))
            poster = np.clip(128 + 400 * cv2.GaussianBlur(noise, (0, 0), 2.5), 0, 255).astype(np.uint8)
        else:
            poster = read_image(self.picture, self.picture.parent)
        metres_from_poster = np.array([[1 / 300, 0, -1.0], [0, 1 / 300, -0.8], [0, 0, 1]])  # on the wall, z = 1
        size = (self.camera.width, self.camera.height)
        for index in range(self.length)[start : None if max_frames is None else start + max_frames]:
            cam_from_world = self.groundtruth.world_from_cam[index].inverse()
            cam_from_wall = cam_from_world.R + np.outer(cam_from_world.t, [0, 0, 1])
            image = cv2.warpPerspective(poster, self.camera.K @ cam_from_wall @ metres_from_poster, size)
            yield Frame(index, index / 30.0, f"{index:03d}", np.asarray(image, np.uint8))


#: A folder with ``poster.png`` is one of this kind.
LAYOUT = Layout(
    "poster", "poster.png", file_of("poster.png"), lambda folder, picture: Poster(name=folder.name, picture=picture)
)
