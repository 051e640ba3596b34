"""A camera of every lens model, and tracks of points all around a camera that moves sideways."""

import math

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations

_CENTRE = (318.3, 241.7)


def camera(model: str, focal_px: float, *coefficients: float) -> Camera:
    """A camera of 640x480 pixels."""
    return Camera(model, 640, 480, focal_px, 1.005 * focal_px, *_CENTRE, coefficients)


LENSES = {
    "rational": camera("rational", 320, 0.5, 0.1, 4e-4, -2e-4, 0.02, 0.75, 0.3, 0.03),
    "thin-prism": camera("thin-prism", 390, -0.2, 0.05, 1e-3, -5e-4, 2e-3, 0.05, 0.01, 3e-3, 2e-3, -1e-3, -1e-3, 5e-4),
    "fisheye": camera("fisheye", 190, 0.02, -0.01, 3e-3, -1e-3),
    "thin-prism-fisheye": camera("thin-prism-fisheye", 200, 0.02, -0.01, 1e-3, -5e-4, 3e-3, -1e-3, 2e-3, -1e-3),
    "fov": camera("fov", 260, 1.0),
    "omni": camera("omni", 500, 1.6, -0.2, 0.1, 1e-3, -5e-4),
    "double-sphere": camera("double-sphere", 150, -0.2, 0.58),
    "eucm": camera("eucm", 220, 0.63, 1.1),
    "equirectangular": Camera("equirectangular", 640, 480, 320 / math.pi, 480 / math.pi, 319.5, 239.5),
}


def directions(count: int, seed: int = 1) -> np.ndarray:
    """Unit rays (count, 3) in all directions."""
    rays = np.random.default_rng(seed).normal(size=(count, 3))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def tracks(lens: Camera, frames: int, noise_px: float = 0.2, points: int = 900, step: float = 0.02):
    """Observations of points two to five units away in all directions; the camera moves to the side and turns."""
    rng = np.random.default_rng(3)
    cloud = directions(points) * rng.uniform(2.0, 5.0, (points, 1))
    for frame in range(frames):
        local = (cloud - (step * frame, 0.0, 0.3 * step * frame)) @ rotation_from_vector(
            np.array([0.002, 0.006, 0.003]) * frame
        )
        pixels = lens.project(local) + noise_px * rng.normal(size=(points, 2))
        rays = lens.bearings(pixels)
        inside = (pixels >= 0).all(axis=1) & (pixels <= (lens.width - 1, lens.height - 1)).all(axis=1)
        seen = np.flatnonzero(inside & np.isfinite(rays).all(axis=1))
        yield Observations(frame, frame / 30, f"{frame}", seen, pixels[seen], rays[seen])
