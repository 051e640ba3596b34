"""The map as other tools open it: nerfstudio's cameras, coloured points, and a scene with its images.

**Cameras.** A pose in ``transforms.json``, as nerfstudio and instant-ngp read it, is ``world_from_cam`` of a camera in
the axes of OpenGL: x right, y up, z backward. The world is that of the map. In nerfstudio the centre of the first pixel
is at (0.5, 0.5), as in COLMAP. The names of the images are relative to a folder ``images`` beside the file.
``ply_file_path`` names the landmarks, with which Gaussian splatting starts.

**A scene** holds undistorted images with cameras and points, for COLMAP, nerfstudio and Gaussian splatting::

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

import json
import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slam_init.errors import SlamInitError, SourceError, check_type
from slam_init.output.colmap import colmap_model
from slam_init.output.folder import OutputFolder
from slam_init.output.names import SCENE, SCENE_FILES
from slam_init.output.plain_json import Json
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Source, as_image
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

# -- cameras and points ----------------------------------------------------------------------------

#: y and z point the other way.
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def opengl_matrix(world_from_cam: Pose) -> Floats:
    """Convert a pose to the axes of OpenGL: returns (4, 4)."""
    return world_from_cam.matrix() @ _FLIP


def transforms_text(map_: InitialMap, located: Sequence[Keyframe] = (), points: str = "map.ply") -> str | None:
    """Write the keyframes, and the frames that were located after the initialization.

    * ``points``: Name of the file of the landmarks.
    * Returns: JSON with a final newline; None where nerfstudio has no such camera model.
    """
    camera = _camera(map_.camera)
    if camera is None:
        return None
    keyframes = sorted({keyframe.frame: keyframe for keyframe in (*located, *map_.keyframes)}.items())
    frames: list[Json] = [
        {"file_path": f"images/{keyframe.name}", "transform_matrix": opengl_matrix(keyframe.world_from_cam).tolist()}
        for _, keyframe in keyframes
    ]
    return json.dumps(camera | {"ply_file_path": points, "frames": frames}, indent=1) + "\n"


def _camera(camera: Camera) -> dict[str, Json] | None:
    """The intrinsics by nerfstudio's names; None for other models than those of OpenCV."""
    shared: dict[str, Json] = {
        "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
    }  # fmt: skip
    if camera.model == "fisheye":
        names: tuple[str, ...] = ("k1", "k2", "k3", "k4")
        model = "OPENCV_FISHEYE"
        shared["is_fisheye"] = True  # instant-ngp reads no camera_model
    elif camera.model in ("pinhole", "radtan"):
        names, model = ("k1", "k2", "p1", "p2", "k3")[: len(camera.distortion)], "OPENCV"
    else:
        return None
    return {"camera_model": model} | shared | dict(zip(names, camera.distortion, strict=True))


def coloured_points(points: Floats, colors: Image, comments: Sequence[str] = (), *, normals: bool = False) -> bytes:
    """Write a PLY file: binary, little-endian; positions are float, colours are uchar.

    Shapes: ``points`` (N, 3), ``colors`` (N, 3).

    * ``normals``: Whether each point has a normal of zeros: the loader of Gaussian splatting asks for some.
    """
    names = ["x", "y", "z", *(("nx", "ny", "nz") if normals else ())]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in comments),
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in names),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "end_header\n",
    ]
    vertices = np.zeros(len(points), [("floats", "<f4", len(names)), ("rgb", "u1", 3)])
    vertices["floats"][:, :3], vertices["rgb"] = points, colors
    return "\n".join(header).encode() + vertices.tobytes()


# -- a scene ---------------------------------------------------------------------------------------

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


# -- its files -------------------------------------------------------------------------------------


def export(
    map_: InitialMap,
    folder: str | os.PathLike[str],
    formats: Collection[str] = ("scene",),
    images: Source | Mapping[int, Image] | None = None,
    located: Sequence[Keyframe] = (),
) -> None:
    """Write a map in the formats of other tools: either all files are replaced, or none.

    Parameters
    ----------
    map_ : InitialMap
    folder : str or path
        A folder that is new, empty, or was written by an earlier call.
    formats : collection of str
        ``scene`` (COLMAP, nerfstudio, Gaussian splatting): see ``docs/how-to/continue.md``.
    images : Source or mapping of int to (H, W) or (H, W, 3) array_like, optional
        The images of the keyframes and of the located frames, by absolute index: grey or BGR, as the initializer got
        them. A source is read again.
    located : sequence of Keyframe
        Further frames with known poses.

    Raises
    ------
    SlamInitError
        If a format is unknown, an image is missing, or a file cannot be written.
    """
    InitialMap.check(map_)
    check_type(located, (tuple, list), "located", "a list of the Keyframes of frames with known poses")
    for one in located:
        check_type(one, Keyframe, "a located frame", "the Keyframes of frames with known poses")
    check_formats(formats)
    with OutputFolder(folder, "export") as out:
        stage(out, "", map_, formats, images, located)
        out.publish()


def check_formats(formats: Collection[str], source: Source | None = None) -> None:
    """Refuse, before any work, formats that are unknown, or that need images which a source does not give again."""
    if isinstance(formats, str) or not isinstance(formats, Collection):
        raise SlamInitError(f"the formats of an export are {formats!r:.40}: give a list, as in ['scene']")
    for one in formats:
        if one != SCENE:
            raise SlamInitError(f"unknown format {one!r:.40} of an export: use {SCENE}")
    if formats and source is not None and source.kind == "live":
        raise SlamInitError("the export scene reads the images again, and a live source is gone: record it first")
    if formats and getattr(source, "pictures", True) is None:
        raise SlamInitError("the export scene needs images: name them by --images")


def stage(
    out: OutputFolder,
    prefix: str,
    map_: InitialMap,
    formats: Collection[str],
    images: Source | Mapping[int, Image] | None,
    located: Sequence[Keyframe] = (),
) -> None:
    """Write the scene of a map to the staging folder, if it is one of the formats.

    * ``prefix``: Of the names of all files.
    """
    if not formats:
        return
    views = {one.frame: one for one in (*located, *map_.keyframes)}
    keyframes = [one.frame for one in map_.keyframes]
    undistortion = Undistortion.of(map_.camera)
    for frame in _frames(images, views):
        as_image(frame.image, f"the image of frame {frame.index}", (map_.camera.width, map_.camera.height))
        image = png(undistortion.image(frame.image))
        out.write({f"{prefix}{SCENE}/images/{image_name(frame.index)}": image})
    files = scene_files(map_, [one for one in views.values() if one.frame not in keyframes], undistortion)
    out.write({f"{prefix}{name}": content for name, content in files.items()})


def _frames(images: Source | Mapping[int, Image] | None, wanted: Collection[int]) -> Iterator[Frame]:
    """The frames of some indices, in order."""
    missing = set(wanted)
    found: Iterator[Frame] = iter(())
    if isinstance(images, Mapping):
        found = (Frame(i, 0.0, image_name(i), images[i]) for i in sorted(missing) if i in images)
    elif images is not None:
        if not callable(getattr(images, "frames", None)):
            kind = type(images).__name__
            raise SourceError(f"the images are of the type {kind}: give open_source(PATH), or a dict by frame")
        found = (frame for frame in images.frames(start=min(missing)))
    for frame in found:
        if frame.index in missing:
            missing.remove(frame.index)
            yield frame
        if not missing:
            return
    raise SourceError(f"the export needs the image of frame {min(missing)}: give the images of all frames of the map")
