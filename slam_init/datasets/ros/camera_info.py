"""Calibrations of ``sensor_msgs/CameraInfo``."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from slam_init.calibration.files import camera_of
from slam_init.types.camera import Camera


def camera_of_info(place: str, info: Any, images: str, image_size: tuple[int, int]) -> Camera | None:
    """Make the camera of a message.

    * ``images``: The topic of the images. Of rectified images (``image_rect``, ``image_rect_color``) the calibration is
      the projection matrix P, without distortion.
    """
    # ROS 1 spells the matrices in capitals, ROS 2 does not.
    K, D, P = (np.asarray(getattr(info, name, getattr(info, name.upper(), ()))).ravel() for name in "kdp")
    rectified = re.search(r"image_rect(_[a-z]+)?(/compressed)?$", images) is not None
    if rectified:
        K = P.reshape(3, 4)[:, :3].ravel()
    if not K.any():
        return None
    content: dict[str, object] = {
        "K": K.tolist(),
        "D": [] if rectified else D.tolist(),
        "distortion_model": "" if rectified else str(info.distortion_model),
        "width": int(info.width),
        "height": int(info.height),
    }
    return camera_of(place, content, image_size)
