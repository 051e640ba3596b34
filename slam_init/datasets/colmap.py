"""Folders with a COLMAP model: images, and the model as calibration and ground truth.

The model lies in the folder, or in ``sparse/0``, ``sparse``, ``colmap/sparse/0`` or ``colmap`` in it; beside a folder
``images`` it may have any name, for example ``dslr_calibration_undistorted`` of ETH3D. The images lie in ``images`` or
in the folder itself. A model is an estimate: it has no scale, and its errors are those of the reconstruction.
"""

from __future__ import annotations

import os
from pathlib import Path

from slam_init.datasets.colmap_files import ColmapImage, model_files, read_cameras, read_images
from slam_init.datasets.image_files import ImageFileSource
from slam_init.datasets.posed_images import PosedImage, posed_source
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside

_USUAL = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "colmap")


def find_colmap_model(folder: str | os.PathLike[str]) -> Path | None:
    """Find the folder that holds the files of a model.

    * Returns: The folder itself, a usual place below it, or else the first folder in it that is a model; None if there
      is none.
    """
    folder = Path(folder)
    usual = [folder, *(folder / place for place in _USUAL)]
    # Other names only where there are images for the model: the folder may be one of many sequences.
    below = sorted(entry for entry in folder.iterdir() if entry.is_dir()) if (folder / "images").is_dir() else []
    return next((place for place in (*usual, *below) if model_files(place)), None)


def open_colmap(folder: str | os.PathLike[str]) -> ImageFileSource:
    """Open a folder of images with a COLMAP model."""
    folder = Path(folder)
    model = find_colmap_model(folder)
    files = None if model is None else model_files(model)
    if model is None or files is None:
        raise SourceError(f"{folder}: holds no COLMAP model (cameras.bin and images.bin, or .txt)")
    check_inside(model, folder)
    cameras = read_cameras(files[0], folder)
    listed = read_images(files[1], folder)
    for image in listed:
        if image.camera_id not in cameras:
            raise SourceError(f"{files[1]}: image {image.name[:100]} has camera {image.camera_id}, which is not stated")
    images = [
        PosedImage(path, image.cam_from_world.inverse(), cameras[image.camera_id])
        for path, image in zip(_paths(folder, listed), listed, strict=True)
    ]
    return posed_source(folder.resolve().name, "colmap", images, folder)


def _paths(folder: Path, images: list[ColmapImage]) -> list[Path]:
    """The files of the images, in the folder where most of the first ones are."""
    first = images[:20]
    places = (folder / "images", folder)
    best = max(places, key=lambda place: sum((place / image.name).is_file() for image in first))
    return [best / image.name for image in images]
