"""Exact geometry seen by a camera: observations and bundle problems, with a chosen noise."""

from dataclasses import replace

import cv2
import numpy as np
from make_map import make_poses

from slam_init.bundle.problem import BundleProblem
from slam_init.config import Config
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import History

CAMERA = Camera("pinhole", 640, 480, 500.0, 510.0, 321.5, 238.25)
CONFIG = Config()
#: A small camera, for views of a texture.
SMALL_SIZE = (320, 240)
SMALL_CAMERA = Camera("pinhole", *SMALL_SIZE, 260.0, 260.0, 159.5, 119.5)


def cloud(rng: np.random.Generator, count: int = 120) -> np.ndarray:
    """Points (count, 3) in general position that all cameras of :func:`make_map.make_poses` see."""
    return rng.uniform([-0.35, -0.25, 0.8], [0.45, 0.25, 1.6], (count, 3))


def plane(rng: np.random.Generator, count: int = 120) -> np.ndarray:
    """Points (count, 3) of a tilted plane ahead."""
    points = cloud(rng, count)
    points[:, 2] = 1.2 + 0.3 * points[:, 0] + 0.2 * points[:, 1]
    return points


def observe(camera, poses, points, noise_px=0.0, rng=None, frames=None) -> list[Observations]:
    """The observations of all points by each camera; the track id of point i is 3 i."""
    frames = frames if frames is not None else range(len(poses))
    seen = []
    for frame, pose in zip(frames, poses, strict=True):
        pixels = camera.project(pose.inverse().apply(points))
        if noise_px:
            pixels = pixels + rng.normal(0, noise_px, pixels.shape)
        ids = 3 * np.arange(len(points))
        seen.append(Observations(frame, frame / 30, f"{frame}.png", ids, pixels, camera.bearings(pixels)))
    return seen


def history_of(observations, camera=CAMERA) -> History:
    """A history that holds all these observations of a camera."""
    history = History(camera, 1000)
    for observed in observations:
        history.put(observed)
    return history


def problem(camera, points, poses=None, noise_px=0.0, rng=None) -> BundleProblem:
    """A bundle problem that starts from the truth, with noise on the pixels only."""
    poses = poses if poses is not None else make_poses(4)
    pixels = np.concatenate([o.pixels for o in observe(camera, poses, points, noise_px, rng)])
    n = len(points)
    return BundleProblem(
        frames=tuple(10 + 7 * k for k in range(len(poses))),
        world_from_cam=tuple(poses),
        points=points,
        track_ids=3 * np.arange(n),
        views=np.repeat(np.arange(len(poses)), n),
        landmarks=np.tile(np.arange(n), len(poses)),
        pixels=pixels,
    )


def with_random_lens(camera, sigmas, rng):
    """A camera whose lens is off as its prior says: log focal length, principal point (2), k1."""
    focal, x, y, k1 = sigmas * rng.normal(size=4)
    return replace(camera.refocused(focal, k1), cx=camera.cx + x, cy=camera.cy + y)


def texture(seed: int, height: int, width: int) -> np.ndarray:
    """A smooth random grey image with structure at several scales."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width))
    for sigma in (1.5, 3.0, 8.0):
        layer = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma)
        image += layer / layer.std()
    return np.clip(128 + 35 * image, 0, 255).astype(np.uint8)


def window(image: np.ndarray, x: float, y: float, width: int, height: int, index: int = 0) -> Frame:
    """A frame that shows the window of the texture at (x, y), interpolated between pixels."""
    centre = (x + (width - 1) / 2, y + (height - 1) / 2)
    return Frame(index, index / 30, f"{index}.png", cv2.getRectSubPix(image, (width, height), centre))
