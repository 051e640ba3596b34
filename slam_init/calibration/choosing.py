"""The camera of frames: the given one, that of their source, or one whose focal length is to be estimated.

The ``camera.txt`` of DSO beside images is read here and not by their source: whoever gives a camera has no use for it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from slam_init.calibration.files import camera_with_focal, load_camera, prior_camera
from slam_init.calibration.metadata import focal_from_metadata, photograph_facts
from slam_init.calibration.models import check_centre
from slam_init.errors import CalibrationError
from slam_init.system.regular_file import check_inside
from slam_init.types.arrays import as_array
from slam_init.types.camera import Camera
from slam_init.types.frame import Source

#: What a caller may give: a camera, a calibration matrix K (3, 3), or None where nothing is known.
GivenCamera: TypeAlias = Camera | ArrayLike | None

#: The kinds of sources whose files may state a focal length, and the attribute that names the files.
_WITH_METADATA = {"images": "paths", "video": "path"}


def camera_of_size(given: GivenCamera, size: tuple[int, int]) -> Camera:
    """The camera of images of a size (width, height).

    Raises CalibrationError if the given one is neither a camera, nor a calibration matrix, nor None.
    """
    if isinstance(given, Camera):
        return given
    if given is None:
        return prior_camera(size)
    check_given(given)
    camera = Camera.from_K(given, size)
    check_centre(camera)
    return camera


def check_given(given: GivenCamera) -> None:
    """Raise CalibrationError unless this is a camera, a matrix (3, 3), or None."""
    if given is not None and not isinstance(given, Camera):
        give = "a Camera (slam_init.load_camera), a matrix K (3, 3), or None to have the focal length estimated"
        as_array(given, np.float64, (3, 3), "the camera", give, CalibrationError)


def camera_of_source(source: Source, given: GivenCamera = None, start: int = 0) -> Camera:
    """The camera of a source from a frame on: the given one, else its own, else by its metadata, else a prior."""
    check_given(given)
    if isinstance(given, Camera):
        return given
    if given is None and source.camera is not None:
        return source.camera
    image = next(source.frames(start, 1)).image
    size = (image.shape[1], image.shape[0])
    stated = None if given is not None else camera_beside(source, size) or camera_of_metadata(source, size)
    return stated or camera_of_size(given, size)


def camera_beside(source: Source, size: tuple[int, int]) -> Camera | None:
    """The camera of the ``camera.txt`` in a folder of images; None where there is none."""
    root = getattr(_files_of(source), "root", None) if source.kind == "images" else None
    if root is None or not (path := Path(root) / "camera.txt").is_file():
        return None
    check_inside(path, root)
    return load_camera(path, size)


def _files_of(source: Source) -> Any:
    """The source of the files: frames that are left out, and masks, change no lens."""
    files: Any = source
    while hasattr(files, "source"):
        files = files.source
    return files


def camera_of_metadata(source: Source, size: tuple[int, int]) -> Camera | None:
    """The camera by what a video or photographs state of their lens; None where they state nothing."""
    files = _files_of(source)
    paths = getattr(files, _WITH_METADATA.get(source.kind, ""), ())
    paths = [paths] if isinstance(paths, str | os.PathLike) else paths
    found = focal_from_metadata(paths, size, getattr(files, "root", None)) if paths else None
    if found is None:
        return None
    return camera_with_focal(size, found.focal_px, found.sigma_px / found.focal_px, "metadata")


def orientation_of(source: Source) -> int:
    """The EXIF orientation of the images of a source; 1 for an upright one, or where none is stated."""
    first = next(iter(getattr(_files_of(source), "paths", ())), None)
    return 1 if first is None else photograph_facts(first).orientation
