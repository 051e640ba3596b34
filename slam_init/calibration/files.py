"""Readers of camera calibrations in the common formats, which are detected by their content; and a writer of one.

A camera of which little is known has nothing but the size of the images, a focal length, or a field of view. The camera
of frames is the given one, that of their source, or one whose focal length is to be estimated.

The formats are the tables of :mod:`slam_init.calibration.formats`; ``docs/how-to/camera.md`` lists them. The
``camera.txt`` of DSO beside images is read here and not by their source: whoever gives a camera has no use for it.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from slam_init.calibration.formats import camera_of_content, content_of_text
from slam_init.calibration.metadata import focal_from_metadata, photograph_facts, size_remedy
from slam_init.calibration.models import check_centre
from slam_init.calibration.values import at_place, parse_arrays, parse_yaml
from slam_init.errors import CalibrationError
from slam_init.system.regular_file import check_inside, read_regular, user_path
from slam_init.types.arrays import as_array
from slam_init.types.camera import Camera
from slam_init.types.frame import Source

#: What a caller may give: a camera, a calibration matrix K (3, 3), or None where nothing is known.
GivenCamera: TypeAlias = Camera | ArrayLike | None

#: The kinds of sources whose files may state a focal length, and the attribute that names the files.
_WITH_METADATA = {"images": "paths", "video": "path"}
#: Given instead of a file: the focal length from the metadata, else from the motion. ``guess`` is its earlier name.
AUTO = ("auto", "guess")
#: What a number begins with.
NUMBERS = ("f=", "fov=")
#: What lenses have, over the longer side of the image: phones 0.67 to 1.0 (24 to 28 mm, videos are cropped), webcams
#: 0.65 to 0.9 (58 to 75 degrees), Kinect 0.82, wide angles of robots and cars 0.5 to 0.65, cameras of photographers 0.7
#: to 1.5 and zooms to 2.5. The logarithm has this median and standard deviation: 0.42 to 1.7 within two of them.
_MEDIAN_FOCAL, _FOCAL_SIGMA = 0.85, 0.35
#: Relative standard deviation of a number that a person knows: data sheets and fields of view are off by 5 %.
_NUMBER_SIGMA = 0.05
#: Fields of view of pinhole images, in degrees: from a telescope to where the border of the image has tangents of 11.
FIELDS_DEG = (0.1, 170.0)


def prior_camera(image_size: tuple[int, int]) -> Camera:
    """The camera of which nothing is known but the size of its images.

    Parameters
    ----------
    image_size : (int, int)
        Width and height in pixels.

    Returns
    -------
    Camera
        A pinhole camera with ``source`` ``prior``; its focal length is to be estimated.

    Raises
    ------
    CalibrationError
        If this is no size.
    """
    if np.shape(image_size) != (2,) or isinstance(image_size[0], str):
        raise CalibrationError(f"the size of the images is {image_size!r:.40}: give (width, height)")
    return camera_with_focal(image_size, _MEDIAN_FOCAL * max(image_size), _FOCAL_SIGMA, "prior")


def camera_with_focal(image_size: tuple[int, int], focal_px: float, focal_sigma: float, source: str) -> Camera:
    """A pinhole camera with the principal point in the centre."""
    width, height = image_size
    centre = ((width - 1) / 2, (height - 1) / 2)
    return Camera("pinhole", width, height, focal_px, focal_px, *centre, source=source, focal_sigma=focal_sigma)


def camera_of_number(text: str, image_size: tuple[int, int]) -> Camera:
    """Read ``f=1250`` (pixels) or ``fov=72`` (degrees across the longer side)."""
    name, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if name == "f" and math.isfinite(value):
        return camera_with_focal(image_size, value, _NUMBER_SIGMA, "stated")
    if name == "f" or not FIELDS_DEG[0] <= value <= FIELDS_DEG[1]:
        degrees = f"{FIELDS_DEG[0]:g} to {FIELDS_DEG[1]:g} degrees across the longer side"
        raise CalibrationError(f"--camera {text!r}: give pixels, as in f=1250, or {degrees}, as in fov=72")
    focal_px = 0.5 * max(image_size) / math.tan(math.radians(0.5 * value))
    return camera_with_focal(image_size, focal_px, _NUMBER_SIGMA, "stated")


_NUMBER = re.compile(r"\d{1,9}(\.\d{0,9})?")

# The largest calibration files in use (Kalibr, of a rig) have 20 kB. A video would keep the parser busy.
_MAX_BYTES = 200_000
_WHAT = "a calibration: give a YAML, JSON, XML, COLMAP or .npz file, or auto"
_ZIP = b"PK\x03\x04"  # what .npz files begin with

# Least share of the image for which the lens model must give rays. The circle of a fisheye may fill half of the image.
# With a wrong coefficient only a spot in the middle has rays.
_MIN_REACHED = 0.2


def load_camera(
    path: str | os.PathLike[str], image_size: tuple[int, int] | None = None, orientation: int = 1
) -> Camera:
    """Read a calibration of any known format.

    Parameters
    ----------
    path : str or path-like
        A file, ``f=1250`` (focal length in pixels), ``fov=72`` (degrees across the longer side), or ``auto``: nothing
        is known, and the focal length is estimated from the motion.
    image_size : (int, int), optional
        Width and height of the images in pixels. If the file states no size, this one is used. If the file states
        another size, it is refused, since the calibration of other images gives a wrong map.
    orientation : int
        The EXIF orientation of the images, for the message of this refusal.

    Returns
    -------
    Camera

    Raises
    ------
    CalibrationError
        If the file is missing, not a calibration, or an impossible one. The message is one line that names file and
        key.
    """
    path, text = user_path(path, CalibrationError), os.fspath(path)
    if text in AUTO or text.startswith(NUMBERS):
        if image_size is None:
            raise CalibrationError(f"--camera {text!r} needs the size of the images")
        return prior_camera(image_size) if text in AUTO else camera_of_number(text, image_size)
    if _NUMBER.fullmatch(text) and not path.exists():
        degrees = f", or fov={text} for degrees" if float(text) <= FIELDS_DEG[1] else ""
        raise CalibrationError(f"--camera {text}: say f={text} for a focal length in pixels{degrees}")
    if "=" in text and not path.exists():
        raise CalibrationError(f"--camera {text!r}: give a file, f=1250 (pixels) or fov=72 (degrees)")
    data = read_regular(path, _MAX_BYTES, _WHAT, CalibrationError)
    with at_place(path):
        content = parse_arrays(data) if data.startswith(_ZIP) else content_of_text(as_text(data))
    return camera_of(str(path), content, image_size, orientation)


def camera_of(
    place: str, content: Mapping[str, object], image_size: tuple[int, int] | None = None, orientation: int = 1
) -> Camera:
    """Make a camera of a calibration that is no file, for example a message."""
    with at_place(place):
        camera = camera_of_content(content, image_size)
        _check(camera, image_size, orientation)
    return replace(camera, source="file")


def _check(camera: Camera, image_size: tuple[int, int] | None, orientation: int = 1) -> None:
    """Refuse a calibration of other images, and distortion coefficients that leave most of the image without rays."""
    if image_size is not None and (camera.width, camera.height) != image_size:
        ours, theirs = f"{camera.width}x{camera.height}", f"{image_size[0]}x{image_size[1]}"
        otherwise = "give their calibration, or scale fx, fy, cx, cy if the images are resized"
        remedy = size_remedy(image_size, (camera.width, camera.height), orientation, otherwise)
        raise CalibrationError(f"calibration is for {ours} images, but the images are {theirs}: {remedy}")
    grid = np.stack(np.meshgrid(np.linspace(0, camera.width - 1, 21), np.linspace(0, camera.height - 1, 21)), axis=-1)
    reached = float(np.isfinite(camera.bearings(grid.reshape(-1, 2))).all(axis=1).mean())
    if reached < _MIN_REACHED:
        problem = f"distortion {list(camera.distortion)} gives rays for {100 * reached:.0f} % of the image only"
        raise CalibrationError(f"{problem}: check the coefficients and their order")


def load_yaml(path: str | os.PathLike[str]) -> dict[str, object]:
    """Read a YAML file by the safe loader; empty where there is no mapping at its top."""
    data = read_regular(path, _MAX_BYTES, _WHAT, CalibrationError)
    with at_place(path):
        content = parse_yaml(as_text(data))
    return content if isinstance(content, dict) else {}


def as_text(data: bytes) -> str:
    """Decode a file, or state in one line why it is no text."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise CalibrationError(f"not a text file: {_WHAT.partition(': ')[2]}")
    if not text.strip():
        raise CalibrationError("the file is empty")
    return text


def camera_yaml(camera: Camera) -> str:
    """Write a calibration."""
    lines = [
        "# pixel centres at integer coordinates; distortion as in OpenCV",
        "model: pinhole" if camera.model != "fisheye" else "model: fisheye",
        f"width: {camera.width}",
        f"height: {camera.height}",
        *(f"{name}: {float(getattr(camera, name))!r}" for name in ("fx", "fy", "cx", "cy")),
        f"distortion_model: {'none' if camera.model == 'pinhole' else camera.model}",
        f"distortion: [{', '.join(repr(float(value)) for value in camera.distortion)}]",
    ]
    if camera.focal_sigma is not None:
        lines.append(f"focal_sigma: {float(camera.focal_sigma)!r}  # relative standard deviation of fx and fy")
    if camera.readout_ms is not None:
        lines += [f"readout_ms: {float(camera.readout_ms)!r}", f"readout_direction: {camera.readout_direction}"]
    return "\n".join(lines) + "\n"


# -- the camera of frames ------------------------------------------------------------------------


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
