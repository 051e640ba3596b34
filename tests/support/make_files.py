"""Files of data sets for tests: images of random pixels, text files, and a calibration that fits the images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np


def picture(seed: int = 0, size: tuple[int, int] = (64, 48), channels: int = 3) -> np.ndarray:
    """An image of random pixels; the size is (width, height)."""
    rng = np.random.default_rng(seed)
    shape = (size[1], size[0], channels) if channels > 1 else (size[1], size[0])
    return rng.integers(0, 255, shape, np.uint8)


def write_image(path: Path, image: np.ndarray | None = None) -> None:
    """Write an image, in the format of the suffix; also makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    encoded, data = cv2.imencode(path.suffix, picture() if image is None else image)
    assert encoded
    path.write_bytes(data.tobytes())


def write(path: Path, content: str | bytes) -> Path:
    """Write a file without any change of line ends; also makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path
