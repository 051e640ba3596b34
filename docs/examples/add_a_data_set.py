"""Add a data set: a class that yields frames and knows the camera and the true trajectory, in about 30 lines of code.

The class need not be registered. Every command accepts its import path: ::

    slam-init run python:docs/examples/add_a_data_set.py:Poster
    slam-init compare python:docs/examples/add_a_data_set.py:Poster --methods quest,poselib

The example shows a poster on a wall. The camera slides past the poster and rotates a little, so each frame is a
homography of the poster. If your data are in files, read the files in ``frames``. For ``slam-init run``, ``camera`` and
``groundtruth`` may be None.

The command imports the attribute and calls it without arguments. To give your class a path, name an attribute that
holds the path, or read an environment variable in a function: ::

    # my_data.py
    hall = functools.partial(Recording, Path("/data/hall"))  # python:my_data:hall

    def any_recording():  # python:my_data:any_recording
        return Recording(Path(os.environ["RECORDING"]))

The module has to be importable: install it, or add its folder to ``PYTHONPATH``.
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


@dataclass(frozen=True)
class Poster:
    """A data set that implements :class:`slam_init.types.frame.TimedSource`."""

    name: str = "poster"
    #: Kind of the source in ``summary.json``.
    kind: str = "example"
    camera: Camera = field(default_factory=lambda: Camera("pinhole", 320, 240, 260.0, 260.0, 159.5, 119.5))
    #: Number of frames.
    length: int = 40

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

        noise = np.random.default_rng(0).normal(size=(600, 800))
        poster = np.clip(128 + 400 * cv2.GaussianBlur(noise, (0, 0), 2.5), 0, 255).astype(np.uint8)
        metres_from_poster = np.array([[1 / 300, 0, -1.0], [0, 1 / 300, -0.8], [0, 0, 1]])  # on the wall, z = 1
        size = (self.camera.width, self.camera.height)
        for index in range(self.length)[start : None if max_frames is None else start + max_frames]:
            cam_from_world = self.groundtruth.world_from_cam[index].inverse()
            cam_from_wall = cam_from_world.R + np.outer(cam_from_world.t, [0, 0, 1])
            image = cv2.warpPerspective(poster, self.camera.K @ cam_from_wall @ metres_from_poster, size)
            yield Frame(index, index / 30.0, f"{index:03d}", np.asarray(image, np.uint8))
