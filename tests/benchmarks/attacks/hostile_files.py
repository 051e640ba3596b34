"""Sequences and files that the attacks on the readers start from."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slam_init.types.arrays import Image

#: A calibration for images of :func:`picture`.
CAMERA = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"


def picture(seed: int = 0, shape: tuple[int, ...] = (48, 64, 3)) -> Image:
    """An image of random pixels."""
    return np.random.default_rng(seed).integers(0, 255, shape, dtype=np.uint8)


def encoded(suffix: str, image: np.ndarray | None = None) -> bytes:
    """The bytes of an image file."""
    import cv2

    return bytes(cv2.imencode(suffix, picture() if image is None else image)[1].tobytes())


def written(path: Path, content: str | bytes) -> Path:
    """Write a file, and make its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def folder_of_images(folder: Path, names: Sequence[str] = ("0.png", "1.png", "2.png")) -> Path:
    """Write images and their calibration."""
    for seed, name in enumerate(names):
        written(folder / name, encoded(Path(name).suffix, picture(seed)))
    written(folder / "camera.yaml", CAMERA)
    return folder


def tum_folder(folder: Path, stamps: Sequence[str] = ("0.0", "0.1", "0.2")) -> Path:
    """Write a sequence in the layout of TUM RGB-D."""
    folder_of_images(folder, [f"{i}.png" for i in range(len(stamps))])
    written(folder / "rgb.txt", "".join(f"{stamp} {i}.png\n" for i, stamp in enumerate(stamps)))
    return folder


def huge_png(width: int, height: int) -> bytes:
    """A tiny PNG whose header, with a right checksum, states this size."""
    data = bytearray(encoded(".png"))
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)
