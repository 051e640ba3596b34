"""Masks: the pixels of an image that no track may use.

A track uses more than its pixel: the flow compares patches, and a SIFT keypoint is the extremum of a blob. So a point
is trackable where its whole patch or blob is free of ignored pixels. The ignored pixels themselves get the mean of the
others, so that neither the coarse levels of the flow nor the brightness of the frame depend on what they show.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats, Image


class Trackable:
    """The part of an image in which points are tracked.

    * ``mask``: (H, W) Pixels that are 0 are ignored.
    * ``patch_px``: Side of the patches that the flow compares.
    """

    def __init__(self, mask: Image, patch_px: int) -> None:
        import cv2

        self.mask = mask.copy()  # a caller may read the next mask into the same array
        self._patch_radius = patch_px // 2
        # Ignored pixels beyond the border of the image do not exist, so the border is no edge of the mask. The distance
        # is that of squares, as patches are.
        if (mask == 0).any():
            self._distance_px = cv2.distanceTransform((mask > 0).astype(np.uint8), cv2.DIST_C, 3)
        else:
            self._distance_px = np.full(mask.shape, np.inf, np.float32)

    def blanked(self, gray: Image) -> Image:
        """Give the ignored pixels of an image the mean of the others.

        Shapes: ``gray`` (H, W), returns (H, W).
        """
        import cv2

        return np.where(self.mask > 0, gray, np.uint8(round(cv2.mean(gray, self.mask)[0])))

    def patches_are_clear(self, pixels: Floats) -> Bools:
        """Tell around which points the flow compares no ignored pixel.

        Shapes: ``pixels`` (N, 2), returns (N,).
        """
        return self.are_clear(pixels, np.full(len(pixels), float(self._patch_radius)))

    def are_clear(self, pixels: Floats, radii_px: Floats) -> Bools:
        """Tell around which points there is no ignored pixel.

        Shapes: ``pixels`` (N, 2), ``radii_px`` (N,), returns (N,).
        """
        height, width = self.mask.shape
        column, row = np.round(pixels).astype(int).T
        distances = self._distance_px[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return np.asarray(distances > radii_px, bool)

    def detectable(self) -> Image:
        """Where corners may be detected.

        Shapes: returns (H, W).
        """
        return np.where(self._distance_px > self._patch_radius, np.uint8(255), np.uint8(0))
