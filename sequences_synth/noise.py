"""Effects of the sensor: motion blur, exposure, shot and read noise."""

from __future__ import annotations

from typing import cast

import numpy as np

from sequences_synth.arrays import Floats32, Image

# Blur of less than this half length in pixels is skipped: it does not affect feature detectors.
_LEAST_BLUR_PX = 0.1
# An image is averaged over one sample per pixel of the blur, but over no more samples than this.
_MAX_SAMPLES = 9
# Share of the noise variance at mid grey that is read noise. The rest is shot noise, whose variance is proportional to
# the light.
_READ_SHARE = 0.3
_MID_GREY = 128.0


def blur_along(image: Image, half_flow: Floats32) -> Image:
    """Average an image along the motion of its pixels.

    The average is symmetric about the middle of the exposure, so that no feature is displaced.

    Shapes: ``image`` (H, W, 3), ``half_flow`` (H, W, 2), returns (H, W, 3).

    * ``half_flow``: Motion of each pixel from the middle of the exposure to its end, pixels.
    * Returns: The given image itself where the blur is below a tenth of a pixel.
    """
    import cv2

    # The number of samples suits 95 % of the pixels: a few at the border or on near objects have a longer blur.
    longest = float(np.percentile(np.hypot(half_flow[::8, ::8, 0], half_flow[::8, ::8, 1]), 95))
    if longest < _LEAST_BLUR_PX:
        return image
    samples = int(np.clip(np.ceil(2 * longest), 2, _MAX_SAMPLES))
    height, width = image.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    u, v = np.ascontiguousarray(half_flow[..., 0]), np.ascontiguousarray(half_flow[..., 1])
    total = np.zeros(image.shape, np.uint16)
    # The instants are the middles of equal parts of the exposure.
    for instant in ((2 * np.arange(samples) + 1) / samples - 1).astype(np.float32):
        moved = cv2.remap(image, x + instant * u, y + instant * v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        total += cast(Image, moved)
    return cast(Image, cv2.convertScaleAbs(total, alpha=1 / samples))


def expose(image: Image, gain: float, noise: float, rng: np.random.Generator) -> Image:
    """Apply a gain and sensor noise.

    Shapes: ``image`` (H, W, 3), returns (H, W, 3).

    * ``gain``: Factor on the light.
    * ``noise``: Standard deviation of the luminance at mid grey, grey levels. Shot noise grows with the square root of
      the light; read noise does not depend on the light.
    """
    import cv2

    if noise == 0.0:
        return image if gain == 1.0 else cast(Image, cv2.convertScaleAbs(image, alpha=gain))
    grey = np.arange(256) * gain
    sigma = noise * np.sqrt(_READ_SHARE + (1 - _READ_SHARE) * grey / _MID_GREY)
    # The three channels share one draw: the luminance then has the requested noise, at a third of the cost. The green
    # channel is taken as the amount of light.
    grain = rng.standard_normal(image.shape[:2], np.float32) * sigma.astype(np.float32)[image[..., 1]]
    noisy = cv2.merge([grain, grain, grain])
    noisy = cv2.scaleAdd(image.astype(np.float32), gain, noisy)
    # This rounds and saturates.
    return cast(Image, np.clip(noisy + np.float32(0.5), 0, 255).astype(np.uint8))
