"""Tracks from elsewhere whose rays have other axes than the project's: x right, y down, z forward."""

from __future__ import annotations

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.history import check_lengths

#: The correction of a rolling shutter moves rays by the turn of the camera during half of a readout: 200 degrees a
#: second over 15 ms. Other axes, or another camera, move the typical ray by more, unless all rays are near the axis.
_LARGEST_MOVE_RAD = np.radians(3.0)
#: Axes of other systems as factors of (x, y, z), and what they are called.
_OTHER_AXES = {
    (1.0, -1.0, -1.0): "those of OpenGL (y up, z backward): multiply y and z by -1",
    (1.0, -1.0, 1.0): "with y up: multiply y by -1",
    (-1.0, -1.0, 1.0): "with x left and y up: multiply both by -1",
    (-1.0, -1.0, -1.0): "the rays from the points to the camera: multiply them by -1",
    (1.0, 1.0, -1.0): "with z backward: multiply z by -1",
}
#: A pixel this many sizes of the image away from it is no measurement of this camera: a lens of 170 degrees has rays at
#: eleven sizes. The polynomials of the fields of correlated errors of all tracks would follow it.
_FARTHEST_SIZES = 20.0


def check_pixels(camera: Camera, frame: int, pixels: Floats) -> None:
    """Raise SlamInitError where pixels are far outside of the image."""
    far = (np.abs(pixels) > _FARTHEST_SIZES * max(camera.width, camera.height)).any(axis=1)
    if far.any():
        worst = np.array2string(pixels[int(np.argmax(far))], precision=3)
        raise SlamInitError(f"frame {frame}: the pixel {worst} is far outside of the image: leave it out")


def check_rays(camera: Camera, current: Observations) -> None:
    """Raise SlamInitError where pixels are far outside of the image, or where bearings are not their rays.

    The message names the axes of such bearings.
    """
    bearings, pixels = current.bearings, current.pixels
    check_lengths(f"frame {current.frame}", bearings)
    check_pixels(camera, current.frame, pixels)
    rays = camera.bearings(pixels)
    known = np.isfinite(rays).all(axis=1)
    if not known.any():
        return
    rays, bearings = rays[known], bearings[known]

    def typical_rad(axes: tuple[float, float, float]) -> float:
        chords = np.linalg.norm(bearings * axes - rays, axis=1)
        return float(np.median(2 * np.arcsin(np.minimum(0.5 * chords, 1.0))))

    if typical_rad((1.0, 1.0, 1.0)) <= _LARGEST_MOVE_RAD:
        return
    name = f"frame {current.frame}"
    for axes, what in _OTHER_AXES.items():
        if typical_rad(axes) <= _LARGEST_MOVE_RAD:
            raise SlamInitError(f"{name}: the bearings are {what} (x right, y down, z forward is expected)")
    raise SlamInitError(f"{name}: the bearings are not the rays of the pixels: give camera.bearings(pixels)")
