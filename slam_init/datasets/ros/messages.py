"""Decodes the messages of a camera: ``sensor_msgs/Image``, ``CompressedImage`` and ``CameraInfo``."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, cast

import numpy as np

from slam_init.calibration.files import camera_of
from slam_init.datasets.image_files import Pixels, check_pixels, decode_image
from slam_init.errors import SourceError
from slam_init.types.camera import Camera

#: The message types.
RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


#: The encodings of ``sensor_msgs/image_encodings`` that are pictures: the number of channels, and the conversion of
#: OpenCV to BGR; None for grey and BGR. Names that end with 16 have so many bits.
_ENCODINGS: dict[str, tuple[int, str | None]] = {
    **dict.fromkeys(("mono8", "8uc1", "mono16"), (1, None)),
    **dict.fromkeys(("bgr8", "8uc3", "bgr16"), (3, None)),
    **dict.fromkeys(("rgb8", "rgb16"), (3, "COLOR_RGB2BGR")),
    **dict.fromkeys(("bgra8", "8uc4"), (4, "COLOR_BGRA2BGR")),
    "rgba8": (4, "COLOR_RGBA2BGR"),
    **dict.fromkeys(("yuv422", "uyvy"), (2, "COLOR_YUV2BGR_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, "COLOR_YUV2BGR_YUY2")),
    # The first four pixels of a mosaic; this spelling of OpenCV means the same.
    **{
        f"bayer_{mosaic}{bits}": (1, f"COLOR_Bayer{mosaic.upper()}2BGR")
        for mosaic in ("rggb", "bggr", "gbrg", "grbg")
        for bits in (8, 16)
    },
}


def is_picture(message: Any) -> bool:
    """Tell whether a message holds a picture, and no depth.

    * Returns: An unknown encoding is a picture, so that :func:`decode` names it.
    """
    if hasattr(message, "format"):
        return "compresseddepth" not in str(message.format).lower().replace(" ", "")
    return not str(message.encoding).upper().startswith(("16UC1", "16SC1", "32FC1", "64FC1", "32SC1"))


def decode(place: str, message: Any) -> Pixels:
    """Decode a message to grey or BGR, with the 8 or 16 bits that it has.

    Shapes: returns (H, W).
    """
    import cv2

    data = np.asarray(message.data).view(np.uint8)
    if hasattr(message, "format"):
        return decode_image(place, data.tobytes())
    encoding = str(message.encoding).lower()
    if encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise SourceError(f"{place}: the encoding {encoding[:40]!r} is not supported: use one of {known}")
    (channels, conversion), is_wide = _ENCODINGS[encoding], encoding.endswith("16")
    width, height, step = int(message.width), int(message.height), int(message.step)
    check_pixels(place, width, height)
    row = width * channels * (2 if is_wide else 1)
    step = step or row  # some drivers leave it out
    if step < row or len(data) < step * (height - 1) + row:
        raise SourceError(f"{place}: {len(data)} bytes in rows of {step} hold no {width}x{height} pixels of {encoding}")
    data = np.pad(data, (0, max(0, step * height - len(data))))  # the last row may end with its last pixel
    pixels: Pixels = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])
    if is_wide:
        pixels = pixels.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    pixels = pixels.reshape((height, width, channels) if channels > 1 else (height, width))
    return pixels if conversion is None else cast(Pixels, cv2.cvtColor(pixels, getattr(cv2, conversion)))


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
    content: dict[str, object] = {"K": K.tolist(), "width": int(info.width), "height": int(info.height)}
    if not rectified:
        content |= {"D": D.tolist(), "distortion_model": str(info.distortion_model)}
    return replace(camera_of(place, content, image_size), source="machine")
