"""Two views of random points: the scenes on which the original code of other systems was measured.

A camera with 640x480 pixels and a focal length of 458 px rotates by four degrees about a random axis and translates in
a random direction. ``general``: depths from 1 to 4. ``plane``: a plane with slopes up to 0.7. ``nadir``: a plane
perpendicular to the optical axis of the first camera. ``rotation``: as ``general``, without the translation. The order
of the random draws must not change: the figures of the original code hold for these scenes.
"""

from dataclasses import dataclass

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

KINDS = ("general", "plane", "nadir", "rotation")
CAMERA = Camera("pinhole", 640, 480, 458.0, 458.0, 320.0, 240.0)

_ROTATION_RAD = np.deg2rad(4.0)
_DEPTHS = (1.0, 4.0)
_MAX_SLOPE = 0.7
#: Distance of a plane along its normal, and smallest cosine between a ray and the normal.
_PLANE_DISTANCE, _LEAST_COSINE = 2.0, 0.15
#: Points nearer to the second camera than this are left out.
_NEAREST = 0.1
#: Number of simulated points per wanted match; the second camera does not see all points.
_SURPLUS = 6


@dataclass(frozen=True, eq=False)
class TwoViewScene:
    """Matches of two views, and the true motion."""

    #: pixels1, pixels2: (N, 2) With noise. The pixels of outliers in the second view are uniformly distributed.
    pixels1: Floats
    pixels2: Floats
    #: The translation has length 1, or 0 for ``rotation``.
    cam2_from_cam1: Pose
    #: (N,)
    inliers: Bools

    def is_correct(self, pose: Pose, rotation_deg: float = 5.0, direction_deg: float = 15.0) -> bool:
        """Return whether a pose is within the bounds of the true pose; always False if there is no translation."""
        if not self.cam2_from_cam1.t.any():
            return False
        cosine = (np.trace(pose.R @ self.cam2_from_cam1.R.T) - 1) / 2
        along = pose.t @ self.cam2_from_cam1.t / np.linalg.norm(pose.t)
        return bool(cosine > np.cos(np.deg2rad(rotation_deg)) and along > np.cos(np.deg2rad(direction_deg)))


def make_scene(
    kind: str, baseline: float, seed: int, count: int = 400, noise_px: float = 0.7, outliers: float = 0.1
) -> TwoViewScene:
    """Draw a scene.

    * ``count``: Number of matches; fewer if the second camera does not see as many points.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind {kind!r}: use one of {', '.join(KINDS)}")
    rng, size = np.random.default_rng(seed), (CAMERA.width, CAMERA.height)
    axis = rng.normal(size=3)
    R = rotation_from_vector(_ROTATION_RAD * axis / np.linalg.norm(axis))
    centre = rng.normal(size=3)
    size_of_sample = _SURPLUS * count
    exact1 = np.column_stack([rng.uniform(0, side, size_of_sample) for side in size])
    rays = np.column_stack([(exact1 - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy), np.ones(size_of_sample)])
    if kind in ("general", "rotation"):
        depths = rng.uniform(*_DEPTHS, size_of_sample)
    else:
        slopes = (0.0, 0.0) if kind == "nadir" else (rng.uniform(-_MAX_SLOPE, _MAX_SLOPE) for _ in range(2))
        normal = np.array([*slopes, 1.0])
        cosine = rays @ (normal / np.linalg.norm(normal))
        depths = np.where(cosine > _LEAST_COSINE, _PLANE_DISTANCE / np.maximum(cosine, _LEAST_COSINE), np.nan)
    length = 0.0 if kind == "rotation" else baseline * float(np.nanmedian(depths))
    t = -R @ (length * centre / np.linalg.norm(centre))
    in2 = (rays * depths[:, None]) @ R.T + t
    exact2 = in2[:, :2] / in2[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    seen = (in2[:, 2] > _NEAREST) & (exact2 >= 0).all(axis=1) & (exact2 < size).all(axis=1)
    kept = np.flatnonzero(seen)[:count]
    pixels1 = exact1[kept] + noise_px * rng.normal(size=(len(kept), 2))
    pixels2 = exact2[kept] + noise_px * rng.normal(size=(len(kept), 2))
    outlier = rng.permutation(len(kept))[: int(outliers * len(kept))]
    pixels2[outlier] = np.column_stack([rng.uniform(0, side, len(outlier)) for side in size])
    inliers = np.ones(len(kept), bool)
    inliers[outlier] = False
    return TwoViewScene(pixels1, pixels2, Pose(R, t / length if length > 0 else np.zeros(3)), inliers)
