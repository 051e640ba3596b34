"""Track worlds for which a small risk was stated although the map was false; simulated by plain numpy."""

from collections.abc import Callable

import numpy as np
from make_window import fed

from quest.geometry.quaternion import rotation_from_vector
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.pose import Pose
from slam_init.window.motion import difference_deg

#: An ordinary camera with an exact calibration.
HARD_CAMERA = Camera("pinhole", 640, 480, 457.0, 457.0, 319.5, 239.5)
_FOCAL_PX, _CENTRE = 457.0, np.array([319.5, 239.5])
_FRAMES = 12


def direction_error_deg(
    points: np.ndarray,
    path: Callable[[int], tuple[np.ndarray, np.ndarray]],
    rng: np.random.Generator,
    *,
    noise_px: float,
    overlay: np.ndarray | None = None,
    shift_px: float = 0.0,
) -> float | None:
    """Largest error of the direction of a baseline of the map of an initializer; None without a map.

    Shapes: ``points`` (N, 3), ``overlay`` (N,).

    * ``path``: Rotation vector and position of the camera in a frame.
    * ``overlay``: The tracks that stay at their first pixels.
    * ``shift_px``: Standard deviation of the shift of each frame as a whole.
    """
    seen, first = [], None
    poses = {
        k: Pose(rotation_from_vector(turn), position) for k, (turn, position) in enumerate(map(path, range(_FRAMES)))
    }
    for k, pose in poses.items():
        rays = pose.inverse().apply(points)
        pixels = rays[:, :2] / rays[:, 2:] * _FOCAL_PX + _CENTRE
        first = pixels if first is None else first
        if overlay is not None:
            pixels = np.where(overlay[:, None], first, pixels)
        pixels = pixels + rng.normal(size=pixels.shape) * noise_px + rng.normal(size=2) * shift_px
        inside = ((pixels >= 0) & (pixels <= [639, 479])).all(axis=1) & (rays[:, 2] > 0.02)
        ids = np.flatnonzero(inside)
        seen.append(Observations(k, k / 30, "", ids, pixels[ids], HARD_CAMERA.bearings(pixels[ids])))
    map_ = fed(Initializer(HARD_CAMERA), seen).map
    if map_ is None:
        return None
    reference, *others = map_.keyframes
    errors = []
    for keyframe in others:
        truth = poses[keyframe.frame].inverse() @ poses[reference.frame]
        found = keyframe.world_from_cam.inverse() @ reference.world_from_cam
        errors.append((np.linalg.norm(truth.t), difference_deg(found, truth)[1]))
    longest = max(length for length, _ in errors)
    return float(max(error for length, error in errors if length >= 0.3 * longest))


def ground_and_poles(seed: int) -> float | None:
    """Flat ground and four poles, 0.15 px of noise, no outlier: a wrong motion lays nearly all points on one plane."""
    rng = np.random.default_rng(seed)
    height, pitch = rng.uniform(0.15, 0.6), np.radians(rng.uniform(0, 30))
    rays = _rays(rng.uniform(0, [640, 480], (3000, 2)))
    depths = height / (rays @ [0, np.cos(pitch), np.sin(pitch)])
    depths = np.where((depths > 0.05) & (depths < 8), depths, np.inf)
    for x, z in rng.uniform([-0.8, 0.5], [0.8, 2], (4, 2)):
        on_pole = (abs(rays[:, 0] * z - x) < 0.03) & (rays[:, 1] * z > -0.5) & (rays[:, 1] * z < height)
        depths = np.where(on_pole, np.minimum(depths, z), depths)
    seen = np.isfinite(depths)
    points = (rays[seen] * depths[seen, None])[:300]
    points /= np.median(points[:, 2])
    direction = rng.normal(size=3) * [1, 1, 0.6]
    direction /= np.linalg.norm(direction)
    axis = rng.normal(size=3) * np.radians(1)
    return direction_error_deg(points, lambda k: (axis * np.sin(0.3 * k), 0.015 * k * direction), rng, noise_px=0.15)


def drive_behind_a_logo(seed: int) -> float | None:
    """A forward drive, tracks in the centre, a fifth of them on a static logo."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([230, 170], [410, 310], (300, 2))
    points = _rays(pixels) * rng.uniform(0.6, 1.6, (300, 1))
    logo = np.zeros(300, bool)
    logo[np.argsort(np.abs(pixels - [410, 310]).max(axis=1))[:60]] = True

    def path(k: int) -> tuple[np.ndarray, np.ndarray]:
        return np.radians([0.6 * np.sin(0.6 * k), 0.07 * k, 0]), np.array([0, 0, 0.007 * k])

    return direction_error_deg(points, path, rng, noise_px=0.3, overlay=logo)


def shifted_frames_before_a_wall(seed: int) -> float | None:
    """Forward to a plane, each frame shifted by a stabilizer by a pixel."""
    rng = np.random.default_rng(seed)
    normal = np.array([*rng.normal(size=2) * 0.3, 1.0])
    rays = _rays(rng.uniform(0, [640, 480], (220, 2)))
    points = rays / (rays @ normal)[:, None]
    points = points[(points[:, 2] > 0.3) & (points[:, 2] < 5)]
    points /= np.median(points[:, 2])

    def path(k: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(3), np.array([0.01 * np.sin(0.4 * k), 0.005 * np.sin(0.3 * k), 0.2 * k / _FRAMES])

    return direction_error_deg(points, path, rng, noise_px=0.3, shift_px=1.0)


def _rays(pixels: np.ndarray) -> np.ndarray:
    """Points of some pixels at the depth 1."""
    return np.c_[(pixels - _CENTRE) / _FOCAL_PX, np.ones(len(pixels))]
