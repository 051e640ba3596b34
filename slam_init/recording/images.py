"""Reduces and compresses the images of a recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_init.types.arrays import Image

#: Images are reduced to this many pixels on their longer side, and the images of a pair to half of it. This is enough
#: to check a match by eye, and 300 frames with their tracks take less than 30 MB.
LONG_SIDE_PX, PAIR_SIDE_PX = 640, 320
#: At this quality a match can be checked by eye, and a frame of 640x480 pixels takes about 50 kB.
_JPEG_QUALITY = 75


def reduced_shape(height: int, width: int, long_side_px: int) -> tuple[int, int]:
    """Compute the shape of a reduced image."""
    factor = min(1.0, long_side_px / max(height, width))
    return max(1, round(height * factor)), max(1, round(width * factor))


def reduced(image: Image, long_side_px: int) -> Image:
    """Reduce an image to a largest length of its longer side: ``image`` (H, W), returns (h, w)."""
    import cv2

    height, width = reduced_shape(image.shape[0], image.shape[1], long_side_px)
    if (height, width) == image.shape[:2]:
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def bgr(image: Image) -> Image:
    """Return an image with three channels: ``image`` (H, W), returns (H, W, 3)."""
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def jpeg(image: Image) -> Any:
    """Compress an image. OpenCV does this several times faster than Rerun: ``image`` (H, W)."""
    import cv2
    import rerun as rr

    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")
