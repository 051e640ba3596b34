"""Reduces and compresses the images of a recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_init.types.arrays import Image

__all__ = ["bgr", "jpeg", "reduced", "reduced_shape"]

#: At this quality a match can be judged by eye, and a frame of 640x480 pixels takes about 50 kB.
_JPEG_QUALITY = 75


def reduced_shape(height: int, width: int, long_side_px: int) -> tuple[int, int]:
    """Compute the shape of a reduced image.

    Parameters
    ----------
    height, width : int
        Shape of the image.
    long_side_px : int
        Largest length of the longer side.

    Returns
    -------
    height, width : int
        At least 1, and at most the shape of the image.
    """
    factor = min(1.0, long_side_px / max(height, width))
    return max(1, round(height * factor)), max(1, round(width * factor))


def reduced(image: Image, long_side_px: int) -> Image:
    """Reduce an image to a largest length of its longer side.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
    long_side_px : int
        Largest length of the longer side.

    Returns
    -------
    (h, w) or (h, w, 3) uint8
        The same image if it is not larger.
    """
    import cv2

    height, width = reduced_shape(image.shape[0], image.shape[1], long_side_px)
    if (height, width) == image.shape[:2]:
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def bgr(image: Image) -> Image:
    """Return an image with three channels.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8

    Returns
    -------
    (H, W, 3) uint8
    """
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def jpeg(image: Image) -> Any:
    """Compress an image. OpenCV does this several times faster than Rerun.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8

    Returns
    -------
    rerun.EncodedImage
    """
    import cv2
    import rerun as rr

    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")
