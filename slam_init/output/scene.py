"""The scene of a map as COLMAP, nerfstudio and Gaussian splatting open it: undistorted images with cameras and points.

The files of the scene::

    images/frame-000012.png                     undistorted, three channels
    sparse/0/{cameras,images,points3D}.bin      COLMAP's binary model of these images
    sparse/0/points3D.ply                       its points for Gaussian splatting
    transforms.json, points.ply                 the same for nerfstudio

All images have one pinhole camera. Gaussian splatting reads no principal point: it takes the centre of the image. So
the camera of a scene has its principal point there. A lens without distortion is not resampled: its images are cut,
evenly about the principal point, which is then a quarter of a pixel from the centre at most. Other images are resampled
with cubic interpolation for the widest pinhole camera of the same size that leaves no pixel without a ray.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slam_init.output.colmap import colmap_model
from slam_init.output.names import SCENE, SCENE_FILES
from slam_init.output.nerfstudio import transforms_text
from slam_init.output.ply import coloured_points
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap, Keyframe

#: Largest angle from the optical axis: a pinhole image of a wider lens would be mostly its stretched border. At 60
#: degrees a pixel has an eighth of the solid angle of one in the centre.
_MAX_ANGLE = math.radians(60.0)
#: The focal length is found to a factor of 2 to the power of -40 of its range.
_STEPS = 40
#: A cut that leaves less than half of a side is not made: the principal point is then that of the calibration.
_LEAST_SIDE = 0.5
#: Nodes along each side of the border that must have pixels.
_NODES = 65


@dataclass(frozen=True, eq=False)
class Undistortion:
    """How the images of a camera become those of a pinhole camera."""

    source: Camera
    camera: Camera
    #: Column and row of the source at which the image is cut; None where it is resampled.
    corner: tuple[int, int] | None

    @classmethod
    def of(cls, camera: Camera) -> Undistortion:
        """Choose the camera of the scene."""
        if camera.is_distorted:
            return cls(camera, _widest_pinhole(camera), None)
        left, width = _cut(camera.cx, camera.width)
        top, height = _cut(camera.cy, camera.height)
        centre = (camera.cx - left, camera.cy - top)
        return cls(camera, Camera("pinhole", width, height, camera.fx, camera.fy, *centre), (left, top))

    def image(self, image: Image) -> Image:
        """Undistort an image.

        Shapes: ``image`` (H, W) or (H, W, 3), returns (H', W', 3).
        """
        import cv2

        if self.corner is not None:
            (left, top), (width, height) = self.corner, (self.camera.width, self.camera.height)
            cut = image[top : top + height, left : left + width]
        else:
            x, y = self._places
            cut = np.asarray(cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)
        return cut if cut.ndim == 3 else np.asarray(cv2.cvtColor(cut, cv2.COLOR_GRAY2BGR), np.uint8)

    @cached_property
    def _places(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Where each pixel is in the source: columns and rows, each (H', W')."""
        y, x = np.mgrid[: self.camera.height, : self.camera.width]
        rays = self.camera.bearings(np.column_stack([x.ravel(), y.ravel()]).astype(float))
        places = self.source.project(rays).astype(np.float32).reshape(*x.shape, 2)
        return places[..., 0], places[..., 1]

    def map(self, map_: InitialMap) -> InitialMap:
        """Give the map with the observations of the undistorted images, and with their names."""
        rays = map_.camera.bearings(map_.observation_pixels)
        ahead = rays[:, 2] > math.cos(math.pi / 2 - 1e-3)  # the others are beyond any pinhole image
        pixels = self.camera.project(np.where(ahead[:, None], rays, [0.0, 0.0, 1.0]))
        size = (self.camera.width, self.camera.height)
        inside = ahead & ((pixels >= -0.5) & (pixels < np.array(size) - 0.5)).all(axis=1)
        return replace(
            map_,
            camera=self.camera,
            keyframes=renamed(map_.keyframes),
            observation_keyframes=map_.observation_keyframes[inside],
            observation_landmarks=map_.observation_landmarks[inside],
            observation_pixels=pixels[inside],
        )


def _cut(centre: float, side: int) -> tuple[int, int]:
    """First pixel and number of pixels of the longest part of a side with the centre in its middle."""
    twice = round(2.0 * centre)  # first + last pixel of the part
    first, last = max(0, twice - (side - 1)), min(side - 1, twice)
    return (first, last - first + 1) if last - first + 1 >= _LEAST_SIDE * side else (0, side)


def _widest_pinhole(camera: Camera) -> Camera:
    """The pinhole camera of the same size with the shortest focal length that leaves no pixel without a ray."""
    width, height = camera.width, camera.height
    x, y = np.linspace(0, width - 1, _NODES), np.linspace(0, height - 1, _NODES)
    border = np.vstack([np.column_stack([a, b]) for a, b in (
        (x, 0 * x), (x, 0 * x + height - 1), (0 * y, y), (0 * y + width - 1, y),
    )])  # fmt: skip
    size = np.array([width, height])

    def pinhole(focal: float) -> Camera:
        return Camera("pinhole", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    def fills(focal: float) -> bool:
        places = camera.project(pinhole(focal).bearings(border))
        return bool(((places >= 0) & (places <= size - 1)).all())  # NaN is not inside

    least = math.hypot(width, height) / 2 / math.tan(_MAX_ANGLE)
    low, high = least, max(camera.focal_px, least) * 10.0
    if fills(low):
        return pinhole(low)
    if not fills(high):  # the principal point is out of the image: blank pixels cannot be avoided
        return pinhole(camera.focal_px)
    for _ in range(_STEPS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if fills(middle) else (middle, high)
    return pinhole(high)


def image_name(frame: int) -> str:
    """Name the image of a frame in a scene; names of the source may hold folders, and may have no suffix."""
    return f"frame-{frame:06d}.png"


def renamed(keyframes: Sequence[Keyframe]) -> tuple[Keyframe, ...]:
    """Give keyframes the names of their images in a scene."""
    return tuple(replace(keyframe, name=image_name(keyframe.frame)) for keyframe in keyframes)


def scene_files(map_: InitialMap, located: Sequence[Keyframe], undistortion: Undistortion) -> dict[str, bytes]:
    """Return the content of the files of a scene by name, without its images."""
    undistorted, others = undistortion.map(map_), renamed(located)
    transforms = transforms_text(undistorted, others, "points.ply")
    assert transforms is not None, "nerfstudio has pinhole cameras"
    model = colmap_model(undistorted, others)
    points = np.array([one.xyz for one in model.points]).reshape(-1, 3)
    colors = np.array([one.rgb for one in model.points], np.uint8).reshape(-1, 3)
    ply = coloured_points(points, colors, normals=True)
    contents = (*model.binaries(), ply, transforms.encode(), ply)
    return {f"{SCENE}/{name}": content for name, content in zip(SCENE_FILES, contents, strict=True)}


def png(image: Image) -> bytes:
    """Encode an image.

    Shapes: ``image`` (H, W, 3).
    """
    import cv2

    done, encoded = cv2.imencode(".png", image)
    assert done, "a PNG of 8 bits is always written"
    return encoded.tobytes()
