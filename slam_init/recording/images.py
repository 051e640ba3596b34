"""Reduces, keeps and compresses the images of a recording."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np

from slam_init.types.arrays import Image
from slam_init.types.frame import Frame

#: Images are reduced to this many pixels on their longer side, and the images of a pair to half of it. This is enough
#: to judge a match by eye, and 300 frames with their tracks take less than 30 MB.
LONG_SIDE_PX, PAIR_SIDE_PX = 640, 320
#: At this quality a match can be judged by eye, and a frame of 640x480 pixels takes about 50 kB.
_JPEG_QUALITY = 75
#: Number of small images in memory for the view of a pair. The reference of a pair may be as old as the oldest
#: candidate keyframe.
_MEMORY_FRAMES = 400


class RecentImages:
    """Small copies of the images of the last frames."""

    def __init__(self) -> None:
        self._images: OrderedDict[int, Image] = OrderedDict()

    def add(self, frame: Frame) -> None:
        """Keep a copy of the image of a frame. A frame that is there already is ignored."""
        if frame.index in self._images:
            return
        self._images[frame.index] = reduced(frame.image, PAIR_SIDE_PX)
        if len(self._images) > _MEMORY_FRAMES:
            self._images.popitem(last=False)

    def get(self, index: int) -> Image | None:
        """Look up the copy of a frame: returns (h, w)."""
        return self._images.get(index)


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
