"""The grey levels of images with 16 bits, which are reduced to 8 bits for all images of a sequence alike.

A thermal camera, or one with 12 bits, uses a small part of 65 536 grey levels: their upper eight bits may be four
levels. So the range of the sequence is stretched. It is that of a few of its images and does not change: a track
would take a change for one of the brightness. What lies beyond becomes black or white.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias, cast

import numpy as np

from slam_init.types.arrays import Image, Pairs

#: An image as it is stored.
Pixels: TypeAlias = Image | Pairs

#: Number of images that give the range.
SAMPLES = 9

# Percentiles of an image, so that hot and dead pixels do not count.
_TAILS = (0.1, 99.9)
# The range is widened by this share of itself at both ends, for images that were not looked at. The range that was seen
# keeps two thirds of the 256 levels.
_MARGIN = 0.25
_BLACK, _WHITE = 0, 65535


@dataclass(frozen=True)
class GreyLevels:
    """The levels that become black and white."""

    low: int = _BLACK
    high: int = _WHITE

    @classmethod
    def of(cls, images: Iterable[Pixels]) -> GreyLevels:
        """The range of some images. Those of 8 bits, and black and white ones, are no measurement."""
        ranges = [
            np.percentile(seen, _TAILS)
            for image in images
            if image.dtype == np.uint16 and len(seen := image[(image > _BLACK) & (image < _WHITE)])
        ]
        if not ranges:
            return cls()
        low, high = float(np.min(ranges)), float(np.max(ranges))
        # A level of the image is never spread over several: that would add no texture, and amplify the noise.
        margin = max(_MARGIN * (high - low), 0.5 * (255 - (high - low)))
        low = max(round(low - margin), _BLACK)
        return cls(low, min(max(round(high + margin), low + 255), _WHITE))

    @property
    def note(self) -> str:
        """Note for the user."""
        return f"the images have 16 bits: their grey levels {self.low} to {self.high} are stretched to 8 bits"

    def reduced(self, image: Pixels) -> Image:
        """The image with 8 bits; one that has 8 bits is returned as it is."""
        return cast(Image, image if image.dtype == np.uint8 else self._table[image])

    @cached_property
    def _table(self) -> Image:
        levels = np.clip(np.arange(_WHITE + 1), self.low, self.high) - self.low
        return np.round(levels * (255 / (self.high - self.low))).astype(np.uint8)
