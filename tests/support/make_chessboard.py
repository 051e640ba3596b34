"""A folder with two images of a chessboard whose corners are numbered, as ``planar/opencv_chessboard``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

CAMERA = Camera("radtan", 640, 480, 500.0, 505.0, 320.0, 240.0, (-0.2, 0.05, 0.001, 0.0))
#: cam2_from_cam1 of the two images.
MOTION = Pose(rotation_from_vector(np.array([0.02, 0.1, 0.0])), np.array([-0.3, 0.0, 0.1]))


def two_views(rng: np.random.Generator, count: int = 80) -> tuple[np.ndarray, np.ndarray]:
    """Distorted pixels (count, 2) of points that both cameras see."""
    points = rng.uniform((-1, -0.7, 3), (1, 0.7, 5), (count, 3))
    return CAMERA.project(points), CAMERA.project(MOTION.apply(points))


def write_chessboard(folder: Path, rng: np.random.Generator) -> None:
    """Write blank images, the pixels of 54 corners, the calibration and the ground truth."""
    (folder / "images").mkdir()
    pixels = dict(zip(("a.png", "b.png"), two_views(rng, 54), strict=True))
    for name in pixels:
        cv2.imwrite(str(folder / "images" / name), np.zeros((480, 640), np.uint8))
    rows = [f"{name} {i} {u} {v}" for name, points in pixels.items() for i, (u, v) in enumerate(points)]
    (folder / "corners.txt").write_text("# image corner_id u v\n" + "\n".join(rows))
    (folder / "rgb.txt").write_text("0 images/a.png\n1 images/b.png\n")
    world_from_b = MOTION.inverse()
    q, t = world_from_b.q_wxyz, world_from_b.t
    second = " ".join(map(repr, map(float, [*t, *q[1:], q[0]])))
    (folder / "groundtruth.txt").write_text(f"0 0 0 0 0 0 0 1\n1 {second}\n")
    (folder / "camera.yaml").write_text(
        "model: pinhole\nwidth: 640\nheight: 480\nfx: 500\nfy: 505\ncx: 320\ncy: 240\n"
        "distortion_model: radtan\ndistortion: [-0.2, 0.05, 0.001, 0.0]\n"
    )
