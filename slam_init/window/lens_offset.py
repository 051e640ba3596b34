"""How the lens of a fit differs from the lens in use."""

from __future__ import annotations

from typing import NamedTuple


class LensOffset(NamedTuple):
    """The unknowns of the lens in a joint fit."""

    #: Logarithm of the focal length over that of the lens in use.
    log_scale: float = 0.0
    #: Added to the first coefficient of the radial distortion.
    k1: float = 0.0
    #: Readout of the image, in seconds.
    readout_s: float = 0.0
    #: Added to the principal point.
    principal_px: tuple[float, float] = (0.0, 0.0)

    def centred(self) -> LensOffset:
        """The same lens with the stated principal point, of which one window tells little."""
        return self._replace(principal_px=(0.0, 0.0))

    def from_moved(self, log_scale: float, k1: float) -> LensOffset:
        """The same lens, as it differs from a lens in use that has moved by so much."""
        return self._replace(log_scale=self.log_scale - log_scale, k1=self.k1 - k1)


#: Of the lens in use itself, without a readout.
IN_USE = LensOffset()
