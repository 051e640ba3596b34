"""Finds what is wrong with the images of a sequence as pictures: empty ones, few grey levels, two pictures in one.

The findings only advise. A picture of one scene has no second copy of itself: the phase correlation of its halves is
0.13 at most (median of a sequence; fifteen sequences), that of the two pictures of a stereo camera 0.86 or more.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Image

#: An image uses the grey levels that hold this share of its pixels.
_MOST = 0.99
#: With so few grey levels, the noise of rounding is as large as the texture: four bits.
_FEW_LEVELS = 16
#: Least correlation of the two pictures of a stereo camera.
_LEAST_CORRELATION = 0.35
#: Halves are correlated at this size, in so many frames.
_SIZE, _FRAMES_CORRELATED = (128, 96), 9
#: One pixel of each square of this size is looked at.
_CELL_PX = 8
#: The number of frames is bounded for a video of any length.
_FRAMES_LOOKED_AT = 1000


class PictureCheck:
    """Watches the images of a sequence."""

    def __init__(self) -> None:
        self._levels: list[int] = []
        self._correlations: list[tuple[float, float]] = []

    def observe(self, gray: Image) -> None:
        """Take the next image.

        Shapes: ``gray`` (H, W).
        """
        if len(self._levels) >= _FRAMES_LOOKED_AT:
            return
        self._levels.append(_levels_used(gray))
        if len(self._correlations) < _FRAMES_CORRELATED and self._levels[-1] > 1:
            self._correlations.append(_correlations(gray))

    @property
    def notes(self) -> tuple[str, ...]:
        """Advice for the user."""
        notes: list[str] = []
        used = [levels for levels in self._levels if levels > 1]
        if empty := len(self._levels) - len(used):
            notes.append(f"{empty} of {len(self._levels)} images are empty: all of their pixels have one grey level")
        if used and (levels := round(float(np.median(used)))) <= _FEW_LEVELS:
            notes.append(
                f"the images use {levels} grey levels only, so that few features are found: give images with more "
                "contrast, or all bits that the camera records"
            )
        if self._correlations:
            places = ("side by side", "one above the other")
            for place, correlation in zip(places, np.median(self._correlations, axis=0), strict=True):
                if correlation >= _LEAST_CORRELATION:
                    notes.append(f"each image seems to hold two pictures {place}, as of a stereo camera: cut one out")
        return tuple(notes)


def _levels_used(gray: Image) -> int:
    counts = np.sort(np.bincount(gray[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX].ravel()))[::-1]
    return int(np.searchsorted(np.cumsum(counts), _MOST * counts.sum())) + 1


def _correlations(gray: Image) -> tuple[float, float]:
    """Phase correlations of the left half with the right one, and of the upper half with the lower one."""
    import cv2

    height, width = gray.shape
    halves = (
        (gray[:, : width // 2], gray[:, width - width // 2 :]),
        (gray[: height // 2], gray[height - height // 2 :]),
    )
    window = cv2.createHanningWindow(_SIZE, cv2.CV_32F)
    coarse = [
        [cv2.resize(half.astype(np.float32), _SIZE, interpolation=cv2.INTER_AREA) for half in pair] for pair in halves
    ]
    # Without the means, blank halves correlate with nothing.
    beside, above = (cv2.phaseCorrelate(one - one.mean(), other - other.mean(), window)[1] for one, other in coarse)
    return beside, above
