"""The reprojection factors: gtsam's factor for each lens.

There are three ways. Where gtsam has a calibration for the lens, the factors measure raw pixels. Radial-tangential
lenses with a k3 or a rational part are undistorted first. All others have one virtual pinhole camera for each
observation (:mod:`slam_init.bundle.virtual_cameras`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import gtsam
import numpy as np

from slam_init.bundle.virtual_cameras import needs_virtual_cameras, virtual_cameras
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

_Calibration: TypeAlias = gtsam.Cal3_S2 | gtsam.Cal3DS2 | gtsam.Cal3Fisheye | gtsam.Cal3Unified
#: Makes a reprojection factor: number of the pixel, key of the pose, key of the landmark.
_FactorMaker: TypeAlias = Callable[[int, int, int], gtsam.NonlinearFactor | None]


def calibration_key() -> int:
    """Make the gtsam key ``K(0)`` of the calibration."""
    return int(gtsam.symbol("k", 0))


def gtsam_calibration(camera: Camera, *, adjusted: bool = False) -> _Calibration:
    """Convert a camera to a calibration of gtsam.

    gtsam's Cal3DS2 has no k3 and no rational part. A camera with one is adjusted on undistorted pixels, as a Cal3_S2.

    * ``adjusted``: Whether the calibration is a variable. Then it has a k1: a Cal3DS2 instead of a Cal3_S2.
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    if camera.model == "omni":
        xi, k1, k2, p1, p2 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:5]
        return gtsam.Cal3Unified(fx, fy, 0.0, cx, cy, k1, k2, p1, p2, xi)
    if camera.model == "fisheye":
        return gtsam.Cal3Fisheye(fx, fy, 0.0, cx, cy, *camera.distortion)
    if camera.is_distorted and not is_undistorted_first(camera):
        return gtsam.Cal3DS2(fx, fy, 0.0, cx, cy, *camera.distortion[:4])
    if adjusted:
        return gtsam.Cal3DS2(fx, fy, 0.0, cx, cy, 0.0, 0.0, 0.0, 0.0)
    return gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)


def is_undistorted_first(camera: Camera) -> bool:
    """Tell whether a camera has k3 or a rational part, so that its factors measure undistorted pixels."""
    if camera.model in ("rational", "thin-prism"):
        return True
    return camera.model == "radtan" and len(camera.distortion) == 5 and camera.distortion[4] != 0


def measured_pixels(camera: Camera, pixels: Floats) -> Floats:
    """Convert raw pixels to the pixels that the factors of :func:`projection` measure.

    Shapes: ``pixels`` (N, 2), returns (N, 2).

    * Returns: Undistorted pixels for a camera with k3 or a rational part; otherwise the raw ones.
    """
    if not is_undistorted_first(camera):
        return pixels
    return camera.normalize(pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def projection(camera: Camera, pixels: Floats, noise: gtsam.noiseModel.Base, *, adjusted: bool) -> _FactorMaker:
    """Make a function that makes the reprojection factors of pixels.

    Shapes: ``pixels`` (N, 2).

    * ``adjusted``: Whether the calibration is the variable ``K(0)``; otherwise it is held.
    * Returns: Position of the pixel, key of the pose, key of the landmark -> factor; None for a pixel without a ray.
    """
    if needs_virtual_cameras(camera) and not adjusted:
        return _virtual_projection(camera, pixels, noise)
    measured = measured_pixels(camera, pixels)
    calibration = gtsam_calibration(camera, adjusted=adjusted)
    name = type(calibration).__name__
    if adjusted:
        shared, key = getattr(gtsam, f"GeneralSFMFactor2{name}"), calibration_key()
        return lambda i, pose, landmark: shared(measured[i], noise, pose, landmark, key)
    held = getattr(gtsam, f"GenericProjectionFactor{name}")
    return lambda i, pose, landmark: held(measured[i], noise, pose, landmark, calibration, False, False)


def _virtual_projection(camera: Camera, pixels: Floats, noise: gtsam.noiseModel.Base) -> _FactorMaker:
    """The factors of pixels by pinhole cameras that look along their rays."""
    virtual = virtual_cameras(camera, pixels)

    def factor(i: int, pose: int, landmark: int) -> gtsam.NonlinearFactor | None:
        if not virtual.known[i]:
            return None
        fx, skew, fy = virtual.calibrations[i]
        calibration = gtsam.Cal3_S2(fx, fy, skew, 0.0, 0.0)
        turned = gtsam.Pose3(gtsam.Rot3(virtual.cam_from_virtual[i]), np.zeros(3))
        return gtsam.GenericProjectionFactorCal3_S2(
            np.zeros(2), noise, pose, landmark, calibration, False, False, turned
        )

    return factor
