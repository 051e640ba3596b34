"""Cameras of which little is known: nothing but the size of the images, a focal length, a field of view."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

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
    camera = Camera("pinhole", width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
    return replace(camera, source=source, focal_sigma=focal_sigma)


def camera_of_number(text: str, image_size: tuple[int, int]) -> Camera:
    """Read ``f=1250`` (pixels) or ``fov=72`` (degrees across the longer side)."""
    name, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if name == "f":
        if not math.isfinite(value):
            raise CalibrationError(f"--camera {text!r}: give the focal length in pixels, as in f=1250")
        return camera_with_focal(image_size, value, _NUMBER_SIGMA, "stated")
    if not FIELDS_DEG[0] <= value <= FIELDS_DEG[1]:
        give = f"give the degrees across the longer side of the image, from {FIELDS_DEG[0]:g} to {FIELDS_DEG[1]:g}"
        raise CalibrationError(f"--camera {text!r}: {give}, as in fov=72")
    focal_px = 0.5 * max(image_size) / math.tan(math.radians(0.5 * value))
    return camera_with_focal(image_size, focal_px, _NUMBER_SIGMA, "stated")
