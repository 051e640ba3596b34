"""Images as a recording keeps them: small, and compressed."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_init.types.arrays import Image

__all__ = ["bgr", "jpeg", "reduced", "reduced_shape"]

#: A match can still be judged by eye, and a frame of 640x480 takes some 50 kB.
_JPEG_QUALITY = 75


def reduced_shape(height: int, width: int, long_side_px: int) -> tuple[int, int]:
    """Height and width with at most so many pixels on the longer side, never more than given, never none."""
    factor = min(1.0, long_side_px / max(height, width))
    return max(1, round(height * factor)), max(1, round(width * factor))


def reduced(image: Image, long_side_px: int) -> Image:
    """The image with at most so many pixels on its longer side."""
    import cv2

    height, width = reduced_shape(image.shape[0], image.shape[1], long_side_px)
    if (height, width) == image.shape[:2]:
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def bgr(image: Image) -> Image:
    """(H, W, 3) of a grey image as well."""
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def jpeg(image: Image) -> Any:
    """The image as rerun takes it compressed. OpenCV encodes several times faster than rerun's own way."""
    import cv2
    import rerun as rr

    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")
