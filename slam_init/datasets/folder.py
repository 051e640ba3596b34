"""A plain folder of images, or one with an ``images`` subfolder."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import ImageFileSource, list_images, stored_camera
from slam_init.errors import SourceError

__all__ = ["find_images", "open_folder"]

#: Frame rate of images whose names are no time stamps.
NOMINAL_RATE_HZ = 30.0


def find_images(folder: str | os.PathLike[str]) -> list[Path]:
    """List the images of a folder, or of its subfolder ``images`` if the folder itself holds none.

    Parameters
    ----------
    folder : str or path-like
        An existing folder.

    Returns
    -------
    list of Path
        In natural order of the names; empty if there are no images.
    """
    folder = Path(folder)
    return list_images(folder) or (list_images(folder / "images") if (folder / "images").is_dir() else [])


def open_folder(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a folder of images in natural order of their names.

    Parameters
    ----------
    folder : str or path-like
        A folder for which :func:`find_images` finds images. If it holds ``camera.yaml``, this is the calibration.

    Returns
    -------
    ImageFileSource

    Raises
    ------
    SourceError
        If there are no images, or if the first one cannot be read.
    CalibrationError
        If ``camera.yaml`` is broken or does not fit the images.
    """
    folder = Path(folder)
    paths = find_images(folder)
    if not paths:
        raise SourceError(f"{folder}: holds no image")
    return ImageFileSource(
        folder.resolve().name,
        "images",
        tuple(paths),
        np.array(_timestamps_s(paths)),
        stored_camera(folder, paths[0]),
    )


def _timestamps_s(paths: list[Path]) -> tuple[float, ...]:
    """Time stamps from names in seconds (``1305031453.359684``) or whole nanoseconds; else at the nominal rate.

    A short whole number is a counter, not a time stamp.
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
