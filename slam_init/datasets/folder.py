"""A plain folder of images, or one with an ``images`` subfolder."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, list_images, stored_camera

__all__ = ["find_images", "open_folder"]

#: Where nothing tells the time of an image.
NOMINAL_RATE_HZ = 30.0


def find_images(folder: Path) -> list[Path]:
    """The images of a folder, else of its subfolder ``images``."""
    return list_images(folder) or (list_images(folder / "images") if (folder / "images").is_dir() else [])


def open_folder(folder: Path) -> ImageFileSource:
    """Open a folder of images in natural order of their names; ``camera.yaml`` in it is the calibration."""
    paths = find_images(folder)
    return ImageFileSource(
        folder.resolve().name,
        "images",
        tuple(paths),
        np.array(_timestamps_s(paths)),
        stored_camera(folder, paths[0]),
    )


def _timestamps_s(paths: list[Path]) -> tuple[float, ...]:
    """Seconds from names like ``1305031453.359684`` or nanoseconds, else nominal.

    A short whole number is a counter, not a time.
    """
    stems = [path.stem for path in paths]
    nominal = tuple(i / NOMINAL_RATE_HZ for i in range(len(paths)))
    if all(re.fullmatch(r"\d+\.\d+", stem) for stem in stems):
        stamps = tuple(float(stem) for stem in stems)
    elif all(re.fullmatch(r"\d{16,19}", stem) for stem in stems):
        stamps = tuple(int(stem) / 1e9 for stem in stems)
    else:
        return nominal
    return stamps if bool(np.all(np.diff(stamps) > 0)) else nominal
