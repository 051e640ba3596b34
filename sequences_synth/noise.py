"""What the sensor adds: motion blur, exposure, shot and read noise."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

__all__ = ["blur_along", "expose"]

Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]

# Blur shorter than this (pixels, half length) is not seen by any detector.
_LEAST_BLUR_PX = 0.1
# Samples along a blur: one a pixel, no more than this many.
_MOST_TAPS = 9
# Share of the noise variance at mid grey that is read noise; the rest is shot noise, proportional to the
# light.
_READ_SHARE = 0.3
_MID_GREY = 128.0


def blur_along(image: Image, half_flow: Floats32) -> Image:
    """Average an image along the motion of its pixels, symmetrically, so that no feature is displaced.

    Parameters
    ----------
    image : (H, W, 3) uint8
    half_flow : (H, W, 2) float32
        How far each pixel moves from the middle of the exposure to its end, pixels.
    """
    import cv2

    # The longest blurs are at the rim of the image or on near objects: size the taps for nearly all pixels.
    longest = float(np.percentile(np.hypot(half_flow[::8, ::8, 0], half_flow[::8, ::8, 1]), 95))
    if longest < _LEAST_BLUR_PX:
        return image
    taps = int(np.clip(np.ceil(2 * longest), 2, _MOST_TAPS))
    height, width = image.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    u, v = np.ascontiguousarray(half_flow[..., 0]), np.ascontiguousarray(half_flow[..., 1])
    total = np.zeros(image.shape, np.uint16)
    # Middles of equal parts of the exposure.
    for instant in ((2 * np.arange(taps) + 1) / taps - 1).astype(np.float32):
        moved = cv2.remap(image, x + instant * u, y + instant * v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        total += cast(Image, moved)
    return cast(Image, cv2.convertScaleAbs(total, alpha=1 / taps))


def expose(image: Image, gain: float, noise: float, rng: np.random.Generator) -> Image:
    """Apply a gain and sensor noise.

    Parameters
    ----------
    image : (H, W, 3) uint8
    gain : float
        Factor on the light.
    noise : float
        Standard deviation of the luminance at mid grey, grey levels: shot noise grows with the root of the
        light, read noise does not depend on it.
    rng : numpy.random.Generator
        Of this frame alone.
    """
    import cv2

    if noise == 0.0:
        return image if gain == 1.0 else cast(Image, cv2.convertScaleAbs(image, alpha=gain))
    grey = np.arange(256) * gain
    sigma = noise * np.sqrt(_READ_SHARE + (1 - _READ_SHARE) * grey / _MID_GREY)
    # One draw for the three channels: the noise of the luminance is then what the caller asked for, at a
    # third of the cost. The green channel stands for the light.
    grain = rng.standard_normal(image.shape[:2], np.float32) * sigma.astype(np.float32)[image[..., 1]]
    noisy = cv2.merge([grain, grain, grain])
    noisy = cv2.scaleAdd(image.astype(np.float32), gain, noisy)
    # Rounds and saturates.
    return cast(Image, np.clip(noisy + np.float32(0.5), 0, 255).astype(np.uint8))
