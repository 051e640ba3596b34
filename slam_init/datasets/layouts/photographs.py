"""Images with poses and no times: COLMAP, nerfstudio and instant-ngp, TrakMark.

**COLMAP**: the model lies in the folder, or in ``sparse/0``, ``sparse``, ``colmap/sparse/0`` or ``colmap`` in it.
Beside a folder ``images`` it may have any name, for example ``dslr_calibration_undistorted`` of ETH3D. The images lie
in ``images`` or in the folder itself. A model is an estimate: it has no scale, and its errors are those of the
reconstruction.

**transforms.json** (nerfstudio, instant-ngp, Blender) states for each image ``file_path`` and ``transform_matrix``,
world_from_cam of an OpenGL camera (x right, y up, z backward), and the calibration for all images or for each one:
``fl_x``, ``fl_y`` or ``camera_angle_x``, ``cx``, ``cy``, ``w``, ``h``, ``k1`` to ``k4``, ``p1``, ``p2``. As in COLMAP,
from which most of these files are made, pixel centres lie at .5.

**TrakMark**, the benchmark of which [F17] uses the NAIST sequences, provides images with intrinsic parameters and, for
each image, extrinsic parameters. The names and headers of its files differ between the packages, and could not be
checked with a file of the data set. The reader takes the general form:

* images in the folder or in ``images``;
* one text file with ``intrinsic`` in its name: ``fx fy cx cy``, or a matrix of 3x3 numbers;
* one text file with ``extrinsic`` in its name: for each image in the order of the names a line of 12 or 16 numbers, the
  matrix cam_from_world, perhaps with a frame number before it.

References
----------
.. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", arXiv:1704.02672.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slam_init.calibration.files import as_text, camera_of
from slam_init.calibration.syntax import parse_json
from slam_init.calibration.values import Section, at_place
from slam_init.datasets.colmap import model_files, read_model
from slam_init.datasets.image_files import (
    IMAGE_SUFFIXES,
    NOMINAL_RATE_HZ,
    ImageFileSource,
    image_folder,
    image_size,
    list_images,
    stored_camera,
)
from slam_init.datasets.posed_images import Layout, PosedImage, file_of, image_sequence, photographs, with_axes
from slam_init.datasets.text import pose_from_matrix, read_poses_of
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import as_array
from slam_init.types.camera import Camera

#: Names of the index; the first that exists is read. The second is that of Blender's synthetic scenes.
TRANSFORMS = ("transforms.json", "transforms_train.json")
_TRAKMARK_TABLES = (".txt", ".csv", ".dat")
_COLMAP_PLACES = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "colmap")
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
_INTRINSICS = (
    *("fl_x", "fl_y", "camera_angle_x", "cx", "cy", "w", "h", "camera_model", "is_fisheye"),
    *_COEFFICIENTS,
)
# Without the models of spheres and prisms, whose coefficients these files have no keys for.
_MODELS = ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")


#: The top level of a JSON file. A value is checked when it is read.
JsonObject = dict[str, object]

# A million poses with file names have 100 to 400 MB as JSON; the largest scenes in use have a few thousand.
_MAX_JSON_BYTES = 100_000_000


def find_colmap(folder: Path) -> Path | None:
    """Find the folder of a model: the folder itself, a usual place below it, or else the first folder in it."""
    usual = [folder, *(folder / place for place in _COLMAP_PLACES)]
    # Other names only where there are images for the model: the folder may be one of many sequences.
    below = sorted(entry for entry in folder.iterdir() if entry.is_dir()) if (folder / "images").is_dir() else []
    return next((place for place in (*usual, *below) if model_files(place)), None)


def open_colmap(folder: Path, model: Path) -> ImageFileSource:
    """Open a folder of images with a COLMAP model."""
    check_inside(model, folder)
    listed, cameras = read_model(model, folder)
    # The folder where most of the first images are.
    places = (folder / "images", folder)
    home = max(places, key=lambda place: sum((place / image.name).is_file() for image in listed[:20]))
    images = [
        PosedImage(home / image.name, image.cam_from_world.inverse(), cameras[image.camera_id]) for image in listed
    ]
    return photographs("colmap", folder, images)


def open_transforms(folder: Path, path: Path) -> ImageFileSource:
    """Open a folder with a ``transforms.json``."""
    return photographs("transforms", folder, list(read_transforms(path, folder)))


def read_transforms(path: Path, folder: Path) -> Iterator[PosedImage]:
    """The images of a ``transforms.json``, whether the folder holds them or not."""
    check_inside(path, folder)
    with at_place(path):
        content = parse_json(as_text(read_regular(path, _MAX_JSON_BYTES, "a list of posed images", SourceError)))
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(content, dict) or not isinstance(frames, list) or not frames:
        raise SourceError(f"{path}: frames is missing or empty: expected a list of images")
    size: tuple[int, int] | None = None
    cameras: dict[str, Camera | None] = {}  # by their stated values: most files state one
    for number, frame in enumerate(frames):
        place = f"{path}: frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise SourceError(f"{place}: file_path is missing")
        image = _image_path(folder, frame["file_path"])
        what, give = f"{place}: transform_matrix", "4x4 finite numbers"
        matrix = as_array(frame.get("transform_matrix"), np.float64, (None, 4), what, give, SourceError)
        if len(matrix) not in (3, 4):
            raise SourceError(f"{what} has {len(matrix)} rows: give {give}")
        stated = {key: frame.get(key, content.get(key)) for key in _INTRINSICS}
        key = repr(stated)
        if key not in cameras:
            if size is None and (stated["w"] is None or stated["h"] is None) and image.is_file():
                size = image_size(image, folder)
            given: JsonObject = {name: value for name, value in stated.items() if value is not None}
            cameras[key] = _transforms_camera(place, given, size)
        yield PosedImage(image, with_axes(pose_from_matrix(place, matrix), "right, up, backward"), cameras[key])


def _image_path(folder: Path, text: str) -> Path:
    """The file of an image; Blender's scenes name it without its suffix."""
    path = folder / text
    return path if path.suffix.lower() in IMAGE_SUFFIXES else path.with_name(path.name + ".png")


def _transforms_camera(place: str, stated: JsonObject, size: tuple[int, int] | None) -> Camera | None:
    """The camera of a frame; None where the file states no focal length."""
    sized = stated if size is None else {"w": size[0], "h": size[1], **stated}
    if not {"fl_x", "camera_angle_x"} & stated.keys() or not {"w", "h"} <= sized.keys():
        return None  # without a size the image is not in the folder either
    section, name = Section(sized), str(stated.get("camera_model", "OPENCV"))
    with at_place(place):
        if name.upper() not in _MODELS:
            raise CalibrationError(f"camera_model {name[:40]!r} is not supported: use OPENCV or OPENCV_FISHEYE")
        width, height = section.number("w"), section.number("h")
        if "fl_x" in stated:
            fx = section.number("fl_x")
        else:
            angle = section.number("camera_angle_x")
            if not 0 < angle < math.pi:
                raise CalibrationError(f"camera_angle_x is {angle:g}: expected radians between 0 and pi")
            fx = 0.5 * width / math.tan(0.5 * angle)
        fy = section.number("fl_y", fx)
        cx, cy = section.number("cx", width / 2) - 0.5, section.number("cy", height / 2) - 0.5
    lens: JsonObject = {key: stated.get(key, 0.0) for key in _COEFFICIENTS}
    lens |= {"is_fisheye": stated["is_fisheye"]} if stated.get("is_fisheye") else {"model": name}
    camera = camera_of(place, {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy} | lens)
    if camera.model == "rational":
        raise CalibrationError(f"{place}: k4 is not supported for a perspective camera: use k1, k2, k3, p1, p2")
    return camera


def find_trakmark(folder: Path) -> Path | None:
    """Find the extrinsic parameters of a sequence."""
    return _named(folder, "extrinsic")


def _named(folder: Path, word: str) -> Path | None:
    found = (path for path in sorted(folder.glob("*")) if word in path.name.lower() and path.suffix in _TRAKMARK_TABLES)
    return next((path for path in found if path.is_file()), None)


def open_trakmark(folder: Path, extrinsics: Path) -> ImageFileSource:
    """Open a sequence in the manner of TrakMark."""
    paths = list_images(image_folder(folder) or folder)
    poses = [pose.inverse() for pose in read_poses_of(paths, extrinsics, folder)]
    intrinsics = _named(folder, "intrinsic")
    camera = stored_camera(folder, paths[0], "camera.yaml", *([intrinsics.name] if intrinsics else []))
    return image_sequence("trakmark", folder, paths, rate_hz=NOMINAL_RATE_HZ, camera=camera, poses=poses)


LAYOUTS = (
    Layout("transforms", f"{TRANSFORMS[0]} (nerfstudio, instant-ngp)", file_of(*TRANSFORMS), open_transforms),
    Layout("colmap", "cameras and images, .txt or .bin, perhaps in sparse/0 (COLMAP)", find_colmap, open_colmap),
    Layout("trakmark", "a table *extrinsic* (TrakMark)", find_trakmark, open_trakmark),
)
