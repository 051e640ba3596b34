"""Sources made of image files: one list of files and time stamps, read one at a time."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from slam_init.errors import SourceError
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

__all__ = [
    "IMAGE_SUFFIXES",
    "ImageFileSource",
    "check_size",
    "frame_range",
    "list_images",
    "read_image",
    "stored_camera",
]

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".webp", ".jp2"})


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key under which ``img2`` comes before ``img10``."""
    return tuple(
        (0, int(part), part) if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name) if part
    )


def list_images(folder: Path) -> list[Path]:
    """Image files of a folder in natural order; hidden files are left out."""
    files = (entry for entry in folder.iterdir() if entry.suffix.lower() in IMAGE_SUFFIXES)
    return sorted(
        (entry for entry in files if not entry.name.startswith(".")),
        key=lambda entry: natural_key(entry.name),
    )


def read_image(path: Path) -> Image:
    """Read one image as (H, W) grey or (H, W, 3) BGR, uint8.

    16-bit images keep their upper eight bits, a transparency channel is dropped, and an EXIF orientation is
    not applied: calibrations speak of pixels as stored.

    Raises
    ------
    SourceError
        Where the file is missing, cut off, or no image of 8 or 16 bits.
    """
    import cv2

    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror})") from None
    # Decoders fill what is missing of a JPEG with grey and only print a warning. Its entropy-coded data
    # cannot hold a marker, so an intact file has an end marker after its last scan marker.
    if data.startswith(b"\xff\xd8") and data.find(b"\xff\xd9", data.rfind(b"\xff\xda")) < 0:
        raise SourceError(f"{path}: the image is cut off")
    try:
        image = (
            cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
            if data
            else None
        )
    except cv2.error:
        image = None
    if image is None:
        raise SourceError(f"{path}: not a readable image")
    if image.dtype == np.uint16:
        image = np.right_shift(image, 8, dtype=np.uint16, casting="unsafe").astype(np.uint8)
    if image.dtype != np.uint8:
        raise SourceError(f"{path}: pixels are {image.dtype}; convert the image to 8 or 16 bits")
    if image.ndim == 3:
        image = image[..., :3] if image.shape[2] >= 3 else image[..., 0]
    return cast(Image, np.ascontiguousarray(image))


def check_size(what: str, size: tuple[int, int], expected: tuple[int, int], of: str) -> None:
    """Raise SourceError where an image's (width, height) is not the expected one."""
    if size != expected:
        raise SourceError(
            f"{what}: image is {size[0]}x{size[1]}, but {of} is {expected[0]}x{expected[1]}: all must agree"
        )


def frame_range(length: int, start: int, max_frames: int | None, name: str) -> range:
    """Indices of the frames that were asked for.

    Raises
    ------
    SourceError
        Where there are none.
    """
    if not 0 <= start < length:
        raise SourceError(f"{name}: start is {start}, but the source has frames 0 to {length - 1}")
    if max_frames is not None and max_frames < 1:
        raise SourceError(f"{name}: max_frames is {max_frames}: it must be at least 1")
    return range(start, length if max_frames is None else min(length, start + max_frames))


def stored_camera(folder: Path, first_image: Path) -> Camera | None:
    """The calibration in a folder's ``camera.yaml``, if any; it must fit the size of the first image."""
    from slam_init.calibration.files import load_camera

    path = folder / "camera.yaml"
    if not path.is_file():
        return None
    height, width = read_image(first_image).shape[:2]
    return load_camera(path, (width, height))


@dataclass(frozen=True, eq=False)
class ImageFileSource:
    """A :class:`slam_init.types.frame.Source` over image files.

    Attributes
    ----------
    name, kind, camera, groundtruth
        As the protocol says.
    paths : tuple of Path
        One image each.
    timestamps_s : (N,) float
        Strictly increasing.
    """

    name: str
    kind: str
    paths: tuple[Path, ...]
    timestamps_s: Floats
    camera: Camera | None = None
    groundtruth: Trajectory | None = None

    def __len__(self) -> int:
        return len(self.paths)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Yield frames in order; each file is read when it is reached.

        Raises
        ------
        SourceError
            Where an image cannot be read, or differs in size from the camera or from the first one read.
        """
        # Names are relative to the folder that holds all images, as COLMAP wants them.
        root = os.path.commonpath([path.parent for path in self.paths])
        expected = (self.camera.width, self.camera.height) if self.camera else None
        of = "the camera"
        for index in frame_range(len(self), start, max_frames, self.name):
            path = self.paths[index]
            image = read_image(path)
            size = (image.shape[1], image.shape[0])
            if expected is None:
                expected, of = size, f"the first ({path.name})"
            check_size(str(path), size, expected, of)
            yield Frame(index, float(self.timestamps_s[index]), os.path.relpath(path, root), image)
