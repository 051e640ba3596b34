"""Virtual pinhole cameras that look along the rays of observations.

gtsam has calibrations for some lenses only, and all of them are formulas on the plane z = 1. For the other lenses, and
for rays behind the image plane, each observation has a pinhole camera of its own: at the place of the real camera, with
its optical axis along the measured ray. Its calibration is the derivative of the real lens at this ray, so that a
residual has the length of the residual in raw pixels, to first order. Residuals are of a few pixels at most.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera

#: Models whose pixels are undistorted to the plane z = 1 for gtsam. There an image is stretched by the squared inverse
#: cosine of the angle, and so is the noise: by four at 60 degrees.
_PERSPECTIVE = ("rational", "thin-prism")
_WIDEST_PERSPECTIVE_RAD = math.radians(60.0)
#: gtsam's unified model projects from the plane z = 1. Beyond 85 degrees a landmark may be pushed behind the plane.
_WIDEST_OMNI_RAD = math.radians(85.0)


class VirtualCameras(NamedTuple):
    """One pinhole camera for each observation."""

    #: (N, 3, 3) Rotations; the third column is the measured ray.
    cam_from_virtual: Floats
    #: (N, 3) Fx, skew and fy in pixels; the principal point is 0.
    calibrations: Floats
    #: (N,) Whether the pixel has a ray; the other rows hold any numbers.
    known: Bools


def needs_virtual_cameras(camera: Camera) -> bool:
    """Tell whether gtsam has no calibration for a camera, or none that serves."""
    if camera.lens is None:
        return False
    if camera.model in _PERSPECTIVE:
        return camera.widest_rad > _WIDEST_PERSPECTIVE_RAD
    return camera.model != "omni" or camera.widest_rad > _WIDEST_OMNI_RAD


def virtual_cameras(camera: Camera, pixels: Floats) -> VirtualCameras:
    """Make the virtual cameras of observations.

    Shapes: ``pixels`` (N, 2).
    """
    rays = camera.bearings(pixels)
    known: Bools = np.asarray(np.isfinite(rays).all(axis=1))
    rays = np.where(known[:, None], rays, [0.0, 0.0, 1.0])
    # The axis that is farthest from the ray gives the first direction across it.
    smallest = np.eye(3)[np.argmin(np.abs(rays), axis=1)]
    right = np.cross(smallest, rays)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down = np.cross(rays, right)
    J = camera.differentiated(rays).by_point @ np.stack([right, down], axis=-1)
    J = np.where(np.isfinite(J).all(axis=(1, 2), keepdims=True), J, camera.focal_px * np.eye(2))
    # J = Q R with a rotation or reflection Q, which does not change the length of a residual.
    fx = np.hypot(J[:, 0, 0], J[:, 1, 0])
    skew = np.einsum("ni,ni->n", J[:, :, 0], J[:, :, 1]) / fx
    fy = np.abs(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]) / fx
    return VirtualCameras(np.stack([right, down, rays], axis=-1), np.column_stack([fx, skew, fy]), known)
