"""A plain folder of images, or one with an ``images`` subfolder."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, holds_image, list_images, stored_camera
from slam_init.datasets.stamps import image_times
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.time_stamps import TimeUnit

#: Frame rate of images whose names are no time stamps.
NOMINAL_RATE_HZ = 30.0


def find_images(folder: str | os.PathLike[str]) -> list[Path]:
    """List the images of a folder, or of its subfolder ``images`` if the folder itself holds none."""
    folder = Path(folder)
    return list_images(folder) or (list_images(folder / "images") if (folder / "images").is_dir() else [])


def holds_images(folder: Path) -> bool:
    """Tell whether a folder, or its subfolder ``images``, holds an image."""
    return holds_image(folder) or ((folder / "images").is_dir() and holds_image(folder / "images"))


def open_folder(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a folder of images in natural order of their names.

    * ``folder``: A folder for which :func:`find_images` finds images. If it holds ``camera.yaml``, this is the
      calibration.
    """
    folder = Path(folder)
    paths = find_images(folder)
    if not paths:
        raise SourceError(f"{folder}: holds no image")
    timestamps_s, notes = _times(paths)
    return ImageFileSource(
        folder.resolve().name,
        "images",
        tuple(paths),
        timestamps_s,
        stored_camera(folder, paths[0]),
        notes=notes,
        root=folder,
    )


def _times(paths: list[Path]) -> tuple[Floats, tuple[str, ...]]:
    """Time stamps in seconds from the names of the images, and notes on their unit; else at the nominal rate.

    A name is a time stamp if it is a number with a decimal point, or a whole number of at least 13 digits: a date in
    milliseconds has 13. A shorter whole number is a counter. Names that are no possible time stamps (they do not
    increase, or lie beyond 2^63) are no error, because nobody has said that they are time stamps.
    """
    stems = [path.stem for path in paths]
    nominal = np.arange(len(paths)) / NOMINAL_RATE_HZ
    if all(re.fullmatch(r"\d+\.\d+", stem, re.ASCII) for stem in stems):
        stated = TimeUnit.SECONDS
    elif all(re.fullmatch(r"[1-9]\d{12,18}", stem, re.ASCII) for stem in stems):
        stated = TimeUnit.NANOSECONDS
    else:
        return nominal, ()
    try:
        return image_times([float(stem) for stem in stems], stems, stated)
    except SourceError:
        return nominal, ()
