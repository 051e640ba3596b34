"""Rolling shutters: the rows or columns of an image are exposed one after the other.

A pixel (x, y) is exposed at ::

    t_frame + readout * (y / height - 1/2)      direction "down"
    t_frame - readout * (y / height - 1/2)      direction "up"
    t_frame + readout * (x / width  - 1/2)      direction "right"
    t_frame - readout * (x / width  - 1/2)      direction "left"

The time stamp and the true pose of a frame are those of its middle row or column. A readout of 0 is a global shutter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats

#: The directions in which the rows or columns are read.
READOUT_DIRECTIONS: tuple[str, ...] = ("down", "up", "right", "left")
# Those in which columns are read one after the other, and not rows.
_BY_COLUMNS = ("right", "left")


@dataclass(frozen=True)
class Shutter:
    """A rolling shutter."""

    #: Time from the first to the last row or column; 0 for a global shutter.
    readout_s: float
    #: One of :data:`READOUT_DIRECTIONS`.
    direction: str
    #: width, height: Image size in pixels.
    width: int
    height: int

    def row_delay_s(self, row: Floats) -> Floats:
        """Compute the exposure times of rows, or of columns where these are read."""
        sign = -1.0 if self.direction in ("up", "left") else 1.0
        lines = self.width if self.direction in _BY_COLUMNS else self.height
        return np.asarray(sign * self.readout_s * (row / lines - 0.5))

    def delay_s(self, pixels: Floats) -> Floats:
        """Compute the exposure times of pixels.

        Shapes: ``pixels`` (..., 2).
        """
        return self.row_delay_s(pixels[..., 0 if self.direction in _BY_COLUMNS else 1])
