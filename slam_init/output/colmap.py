"""Writes the initial map as a COLMAP model, with COLMAP's camera or one that stands for it."""

from __future__ import annotations

import math
import re
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.errors import SlamInitError, plain_line
from slam_init.output.names import COLMAP_FILES
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

#: COLMAP's models with the same parameters in the same order.
_SAME_PARAMETERS = {
    "pinhole": "PINHOLE", "fisheye": "OPENCV_FISHEYE", "rational": "FULL_OPENCV",
    "thin-prism-fisheye": "THIN_PRISM_FISHEYE", "fov": "FOV", "eucm": "EUCM",
}  # fmt: skip
#: Number of coefficients that COLMAP's models take, where a lens with more radial distortion has one more.
_COEFFICIENTS = {"fov": 1, "eucm": 2}
#: COLMAP's number of the model ``PINHOLE``.
_PINHOLE = 1


def colmap_note(camera: Camera) -> str:
    """Tell what a COLMAP model cannot say about a camera."""
    if camera.model == "equirectangular" and not is_whole_sphere(camera):
        what = "panoramas of the whole sphere only"
    elif camera.model in ("omni", "double-sphere", "thin-prism"):
        what = f"no {camera.model} model"
    elif len(camera.distortion) > _COEFFICIENTS.get(camera.model, len(camera.distortion)):
        what = f"no {camera.model} model with more radial distortion"
    else:
        return ""
    return f"COLMAP has {what}: the observations in colmap/ are those of an undistorted PINHOLE camera"


def is_whole_sphere(camera: Camera) -> bool:
    """Return whether a camera is a panorama that shows each direction once."""
    sphere = (camera.width / (2 * math.pi), camera.height / math.pi)
    centre = ((camera.width - 1) / 2, (camera.height - 1) / 2)
    same_scale = np.allclose((camera.fx, camera.fy), sphere, rtol=1e-4)
    return same_scale and np.allclose((camera.cx, camera.cy), centre, atol=0.1)


def colmap_camera(camera: Camera) -> tuple[str, list[float]]:
    """Find COLMAP's name and parameters of a camera."""
    centre = [camera.cx + 0.5, camera.cy + 0.5]
    parameters = [camera.fx, camera.fy, *centre, *camera.distortion]
    if camera.model == "equirectangular":
        return "EQUIRECTANGULAR", [camera.width, camera.height]
    if camera.model in _SAME_PARAMETERS:
        return _SAME_PARAMETERS[camera.model], parameters
    if len(camera.distortion) == 5 and camera.distortion[4] != 0:
        # k4, k5, k6: the denominator of the rational model.
        return "FULL_OPENCV", [*parameters, 0.0, 0.0, 0.0]
    return "OPENCV", parameters[:8]


#: A pinhole image is stretched by the squared inverse cosine of the angle: 33 times at 80 degrees. Rays beyond are left
#: out of it.
_LEAST_DEPTH = math.cos(math.radians(80.0))


@dataclass(frozen=True)
class ModelImage:
    """An image of a COLMAP model: ``points`` (N, 2) with COLMAP's pixel centres, and the ids (N,) of their points."""

    name: str
    cam_from_world: Pose
    points: Floats
    point_ids: Ints


@dataclass(frozen=True)
class ModelPoint:
    """A point of a COLMAP model: ``track`` (N, 2) has the id of an image and the position among its points."""

    id: int
    xyz: Floats
    rgb: Image
    error_px: float
    track: Ints


@dataclass(frozen=True)
class ColmapModel:
    """A model with one camera, of id 1. Ids of images begin at 1 in the order of ``images``."""

    camera: Camera
    note: str
    images: tuple[ModelImage, ...]
    points: tuple[ModelPoint, ...]

    def texts(self) -> list[bytes]:
        """Write the contents of ``cameras.txt``, ``images.txt`` and ``points3D.txt``.

        The file system allows names of images that are not Unicode; their bytes are written unchanged.
        """
        model, parameters = colmap_camera(self.camera)
        cameras = (
            (f"# {self.note}\n" if self.note else "") + "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
            f"1 {model} {self.camera.width} {self.camera.height} {numbers_text(parameters)}\n"
        )
        images = [
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
            "# X, Y, POINT3D_ID for each of its points",
        ]
        for k, image in enumerate(self.images, start=1):
            pose = numbers_text([*image.cam_from_world.q_wxyz, *image.cam_from_world.t])
            # A line break in the name of a file would be a line break of the table.
            name = re.sub("[\r\n]", lambda found: plain_line(found[0]), image.name)
            images.append(f"{k} {pose} 1 {name}")
            seen = zip(image.points, image.point_ids, strict=True)
            images.append(" ".join(f"{numbers_text(pixel)} {i}" for pixel, i in seen))
        points = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
        for point in self.points:
            rgb, track = (" ".join(map(str, values)) for values in (point.rgb, point.track.ravel()))
            points.append(f"{point.id} {numbers_text(point.xyz)} {rgb} {numbers_text([point.error_px])} {track}")
        texts = (cameras, "\n".join(images) + "\n", "\n".join(points) + "\n")
        return [text.encode("utf-8", "surrogateescape") for text in texts]

    def binaries(self) -> tuple[bytes, bytes, bytes]:
        """Write the contents of ``cameras.bin``, ``images.bin`` and ``points3D.bin``. The camera is a pinhole."""
        _, parameters = colmap_camera(self.camera)
        size = (self.camera.width, self.camera.height)
        images, points = [struct.pack("<Q", len(self.images))], [struct.pack("<Q", len(self.points))]
        for k, image in enumerate(self.images, start=1):
            pose = (*image.cam_from_world.q_wxyz, *image.cam_from_world.t)
            seen = np.zeros(len(image.points), [("xy", "<f8", 2), ("id", "<u8")])
            seen["xy"], seen["id"] = image.points, image.point_ids
            images += [struct.pack("<I7dI", k, *pose, 1), image.name.encode("utf-8", "surrogateescape") + b"\0"]
            images += [struct.pack("<Q", len(seen)), seen.tobytes()]
        for point in self.points:
            points.append(struct.pack("<Q3d3Bd", point.id, *point.xyz, *point.rgb, point.error_px))
            points += [struct.pack("<Q", len(point.track)), point.track.astype("<u4").tobytes()]
        cameras = struct.pack("<QIi2Q4d", 1, 1, _PINHOLE, *size, *parameters)
        return cameras, b"".join(images), b"".join(points)


def colmap_model(map_: InitialMap, located: Sequence[Keyframe] = ()) -> ColmapModel:
    """Make a COLMAP model of the original images.

    In COLMAP the centre of the first pixel is at (0.5, 0.5), and in this project at (0, 0). Therefore half a pixel is
    added to the principal point and to each observation. Ids begin at 1: images in the order of the keyframes, points
    in the order of the landmarks.

    Some lenses have no model in COLMAP (:func:`~slam_init.output.colmap.colmap_note`). Their observations are
    those of a pinhole camera, so the model is one of images that are undistorted to it. COLMAP's models on the plane
    z = 1 have no place for rays at 89 degrees or more from the optical axis. Those observations are left out, and so
    are points that less than two images observe.

    * ``map_``: Its camera is that of the original images, with the adjusted focal length.
    * ``located``: Further frames. They follow the keyframes, and observe no points.
    """
    InitialMap.check(map_)
    camera, note = map_.camera, colmap_note(map_.camera)
    if note:  # the pinhole camera with the same pixels near the optical axis
        camera = Camera("pinhole", camera.width, camera.height, camera.K[0, 0], camera.K[1, 1], camera.cx, camera.cy)
    all_pixels, used = _observations(map_, camera)
    images = []
    errors_px = np.zeros(len(map_.observation_landmarks))
    positions = np.zeros(len(map_.observation_landmarks), int)  # of an observation among those of its image
    for k, keyframe in enumerate(map_.keyframes):
        rows = np.flatnonzero((map_.observation_keyframes == k) & used)
        landmarks, pixels = map_.observation_landmarks[rows], all_pixels[rows]
        cam_from_world = keyframe.world_from_cam.inverse()
        projected = camera.project(cam_from_world.apply(map_.points[landmarks]))
        errors_px[rows] = np.linalg.norm(projected - pixels, axis=1)
        positions[rows] = np.arange(len(rows))
        images.append(ModelImage(keyframe.name, cam_from_world, pixels + 0.5, landmarks + 1))
    nothing = np.zeros((0, 2)), np.zeros(0, int)
    images += [ModelImage(one.name, one.world_from_cam.inverse(), *nothing) for one in located]

    points = []
    order = np.argsort(map_.observation_landmarks, kind="stable")
    starts = np.searchsorted(map_.observation_landmarks[order], np.arange(len(map_.points) + 1))
    for i, (xyz, rgb) in enumerate(zip(map_.points, map_.colors, strict=True)):
        rows = order[starts[i] : starts[i + 1]]
        rows = rows[used[rows]]
        if len(rows) >= 2:
            track = np.column_stack([map_.observation_keyframes[rows] + 1, positions[rows]])
            points.append(ModelPoint(i + 1, xyz, rgb, float(np.mean(errors_px[rows])), track))
    return ColmapModel(camera, note, tuple(images), tuple(points))


def pycolmap_reconstruction(map_: InitialMap, located: Sequence[Keyframe] = ()) -> Any:
    """Give a map as a ``pycolmap.Reconstruction`` in memory.

    Parameters
    ----------
    map_ : InitialMap
    located : sequence of Keyframe
        Further frames, whose images observe no points.

    Returns
    -------
    pycolmap.Reconstruction
        Of the original images, with half a pixel added as COLMAP's pixel centres ask. Image k + 1 is keyframe k, point
        i + 1 is landmark i.

    Raises
    ------
    SlamInitError
        If pycolmap is not installed.
    """
    try:
        import pycolmap
    except ImportError:
        raise SlamInitError('pycolmap is not installed: pip install ".[colmap]"') from None
    with tempfile.TemporaryDirectory() as folder:  # its reader is the one interface that all versions have
        for name, text in zip(COLMAP_FILES, colmap_model(map_, located).texts(), strict=True):
            Path(folder, Path(name).name).write_bytes(text)
        return pycolmap.Reconstruction(folder)


def _observations(map_: InitialMap, camera: Camera) -> tuple[Floats, Bools]:
    """Pixels (M, 2) of the observations in the camera that is written, and which of them (M,) it has."""
    pixels, lens = map_.observation_pixels, map_.camera.lens
    used: Bools = np.ones(len(pixels), bool)
    if lens is not None:
        rays = map_.camera.bearings(pixels)
        used = np.asarray(np.isfinite(rays).all(axis=1))
        if camera.model == "pinhole":
            used &= np.nan_to_num(rays[:, 2]) > _LEAST_DEPTH
            pixels = camera.project(np.where(used[:, None], rays, [0.0, 0.0, 1.0]))
        elif camera.model != "equirectangular":
            used &= np.isfinite(map_.camera.normalize(pixels)).all(axis=1)
    counts = np.bincount(map_.observation_landmarks[used], minlength=len(map_.points))
    return pixels, np.asarray(used & (counts[map_.observation_landmarks] >= 2))


def numbers_text(values: Sequence[float] | Floats) -> str:
    """Write numbers, separated by spaces.

    Shapes: ``values`` (N,).

    * Returns: Twelve significant digits each. For pixels of any image size this is a billionth of a pixel.
    """
    return " ".join(f"{value:.12g}" for value in values)
