"""Converts published layouts to a folder that is read: ``rgb.txt``, ``groundtruth.txt``, ``camera.yaml``, ``images``.

==============  =====================================================================================================
layout          what the authors publish
==============  =====================================================================================================
``7scenes``     ``frame-000000.color.png`` or ``.jpg``, ``frame-000000.pose.txt`` (4x4, world_from_cam), 30 Hz
``tartanair``   ``image_left`` or ``image_lcam_front``, ``pose_left.txt`` (x y z and quaternion, NED), 10 Hz
``middlebury``  ``NAME_par.txt`` (image, K, R, t with cam_from_world)
``strecha``     images and ``NAME.camera`` (K, 3 zeros, R of world_from_cam, centre, size), also in two folders
``uzh``         ``K.txt``, ``D.txt`` (two radial coefficients of pixels), ``poses.txt`` (rotation vector and t,
                cam_from_world), ``images``, 30 Hz
``colmap``      ``cameras.txt`` with one camera, ``images.txt``, and the images beside them or in ``images``
``read``        a folder that the readers take: TUM RGB-D, ICL-NUIM, EuRoC, KITTI
==============  =====================================================================================================

Images are copied, not changed. The name of a sequence of the manifest in place of a layout also takes its part of the
frames.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bench.manifest import BY_HAND, MANIFEST, READ
from slam_init.calibration.writing import camera_yaml
from slam_init.datasets import open_source
from slam_init.datasets.image_files import ImageFileSource, list_images, read_image
from slam_init.datasets.text import numbers, pose_from_matrix, read_rows
from slam_init.errors import ConfigError, SourceError
from slam_init.output.folder import OutputFolder, output_error, staged_names
from slam_init.output.results import tum_text
from slam_init.system.regular_file import check_inside, user_path
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose

#: More images than any of these data sets has in a sequence.
_MOST_IMAGES = 100_000
_SCENES_HZ = 30.0
#: 7-Scenes states 585 px for the depth camera; the poses fit the colour images best with 525 to 545 px.
_SCENES = Camera("pinhole", 640, 480, 532.57, 531.54, 320.0, 240.0)
#: Axes of TartanAir's world (north, east, down) in those of a camera that looks north (x right, y down, z forward).
_WORLD_FROM_NED = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Converted:
    """A sequence as its authors publish it."""

    images: tuple[Path, ...]
    timestamps_s: tuple[float, ...]
    #: world_from_cam.
    poses: tuple[Pose, ...]
    camera: Camera

    def part(self, first: int, count: int) -> Converted:
        """Return a part of the frames."""
        chosen = slice(first, first + count)
        return Converted(self.images[chosen], self.timestamps_s[chosen], self.poses[chosen], self.camera)


def convert(layout: str, folder: str | os.PathLike[str], out: str | os.PathLike[str]) -> str:
    """Convert a sequence."""
    entry = next((entry for entry in MANIFEST if entry.name == layout), None)
    if entry is not None:
        layout = entry.layout
        if layout == BY_HAND:
            raise ConfigError(f"{entry.name}: no program converts what is published at {entry.url}")
    if layout not in LAYOUTS:
        names = ", ".join((*LAYOUTS, *(entry.name for entry in MANIFEST if entry.layout != BY_HAND)))
        raise ConfigError(f"unknown layout {layout!r}: use one of {names}")
    source = user_path(folder)
    if not source.is_dir():
        raise SourceError(f"{source}: there is no such folder")
    try:
        found = LAYOUTS[layout](source)
    except OSError as error:
        raise SourceError(f"{error.filename or source}: cannot be read ({error.strerror})") from None
    if entry is not None:
        found = found.part(entry.first, entry.count)
    if len(found.images) < 2:
        wanted = "" if entry is None else f" with frames {entry.first} to {entry.first + entry.count - 1}"
        raise SourceError(f"{source}: no sequence of the layout {layout}{wanted}; docs/bench.md tells what it holds")
    height, width = read_image(found.images[0], source).shape[:2]
    if (width, height) != (found.camera.width, found.camera.height):
        size = f"{found.camera.width}x{found.camera.height}"
        raise SourceError(f"{found.images[0]} has {width}x{height} pixels, and its calibration is for {size}")
    with OutputFolder(out, "bench convert") as target:
        try:
            _write(found, source, target.staging)
        except OSError as error:
            raise output_error(Path(out), error) from error
        target.publish(staged_names(target), remove=target.files)
    return f"wrote {len(found.images)} frames to {out}\n"


def _write(found: Converted, source: Path, staging: Path) -> None:
    (staging / "images").mkdir()
    names = []
    for i, path in enumerate(found.images):
        check_inside(path, source)
        names.append(f"{i:06d}{path.suffix.lower()}")
        shutil.copyfile(path, staging / "images" / names[-1])
    keyframes = [
        Keyframe(i, stamp, name, pose)
        for i, (stamp, name, pose) in enumerate(zip(found.timestamps_s, names, found.poses, strict=True))
    ]
    rgb = "".join(f"{keyframe.timestamp_s:.9f} images/{keyframe.name}\n" for keyframe in keyframes)
    (staging / "rgb.txt").write_text(rgb, encoding="ascii")
    (staging / "groundtruth.txt").write_text(tum_text(keyframes), encoding="ascii")
    (staging / "camera.yaml").write_text(camera_yaml(found.camera), encoding="ascii")


def _seven_scenes(folder: Path) -> Converted:
    images, poses, stamps = [], [], []
    for path in _images(folder):
        stem, _, kind = path.stem.rpartition(".")
        if kind != "color":
            continue
        pose_file = path.with_name(f"{stem}.pose.txt")
        matrix = _matrix(pose_file, folder, 4)
        if not np.isfinite(matrix).all():  # tracking was lost
            continue
        images.append(path)
        poses.append(pose_from_matrix(str(pose_file), matrix))
        stamps.append(_index(stem) / _SCENES_HZ)
    return Converted(tuple(images), tuple(stamps), tuple(poses), _SCENES)


def _tartanair(folder: Path) -> Converted:
    found = _readable(folder)
    # The readers keep the axes of the world (north, east, down); these are those of its first camera.
    rotated = (Pose(_WORLD_FROM_NED @ pose.R, _WORLD_FROM_NED @ pose.t) for pose in found.poses)
    return replace(found, poses=tuple(rotated))


def _middlebury(folder: Path) -> Converted:
    lists = sorted(folder.glob("*_par.txt"))
    if len(lists) != 1:
        raise SourceError(f"{folder} has {len(lists)} files *_par.txt: give the folder of one object")
    images, poses, stamps, cameras = [], [], [], []
    for i, row in enumerate(read_rows(lists[0], folder)):
        fields = row[1].split()
        if i == 0 and len(fields) == 1:
            continue  # the number of images
        values = np.array(numbers(row, fields[1:], 21, "image, 9 numbers of K, 9 of R, 3 of t"))
        path = folder / fields[0]
        check_inside(path, folder)
        if not path.is_file():
            continue  # a part of the views
        R, t = values[9:18].reshape(3, 3), values[18:21]
        images.append(path)
        poses.append(pose_from_matrix(row[0], np.column_stack([R, t])).inverse())
        cameras.append(_camera_of(values[:9].reshape(3, 3), path, folder))
        stamps.append(float(_index(path.stem)))
    return _one_camera(images, stamps, poses, cameras, folder)


def _strecha(folder: Path) -> Converted:
    images, poses, cameras = [], [], []
    for path in sorted(folder.rglob("*.camera"))[:_MOST_IMAGES]:
        check_inside(path, folder)
        image = next((p for p in sorted(folder.rglob(path.stem)) if p.is_file()), None)
        if image is None:
            continue
        wanted = "K, three zeros, R, the centre"
        rows = [numbers(row, row[1].split(), 3, wanted) for row in list(read_rows(path, folder))[:8]]
        if len(rows) < 8:
            raise SourceError(f"{path}: expected {wanted}")
        K, R, centre = np.array(rows[:3]), np.array(rows[4:7]), np.array(rows[7])
        images.append(image)
        poses.append(pose_from_matrix(str(path), np.column_stack([R, centre])))
        cameras.append(_camera_of(K, image, folder))
    return _one_camera(images, [float(i) for i in range(len(images))], poses, cameras, folder)


def _uzh(folder: Path) -> Converted:
    K, coefficients = _table(folder / "K.txt", folder, 3), _table(folder / "D.txt", folder, 2)[0]
    if K.shape != (3, 3):
        raise SourceError(f"{folder / 'K.txt'}: expected a matrix 3x3")
    images = _images(folder / "images")
    poses = []
    for row in read_rows(folder / "poses.txt", folder):
        vector = np.array(numbers(row, row[1].split(), 6, "rotation vector and translation"))
        poses.append(Pose(rotation_from_vector(vector[:3]), vector[3:]).inverse())
    count = min(len(images), len(poses))
    if count == 0:
        raise SourceError(f"{folder} holds no image with a pose")
    pinhole = _camera_of(K, images[0], folder)
    # The radius of the published model is in pixels.
    k1, k2 = float(coefficients[0] * pinhole.fx**2), float(coefficients[1] * pinhole.fx**4)
    camera = replace(pinhole, model="radtan", distortion=(k1, k2, 0.0, 0.0))
    stamps = tuple(i / _SCENES_HZ for i in range(count))
    return Converted(tuple(images[:count]), stamps, tuple(poses[:count]), camera)


def _readable(folder: Path) -> Converted:
    source = open_source(folder)
    if not isinstance(source, ImageFileSource) or source.camera is None or source.groundtruth is None:
        raise SourceError(f"{folder} has no images, no calibration or no ground truth: give a published sequence")
    posed = [(i, source.groundtruth.at(float(stamp))) for i, stamp in enumerate(source.timestamps_s)]
    known = [(i, pose) for i, pose in posed if pose is not None]
    return Converted(
        tuple(source.paths[i] for i, _ in known),
        tuple(float(source.timestamps_s[i]) for i, _ in known),
        tuple(pose for _, pose in known),
        source.camera,
    )


def _one_camera(
    images: Sequence[Path], stamps: Sequence[float], poses: Sequence[Pose], cameras: Sequence[Camera], folder: Path
) -> Converted:
    if not images:
        raise SourceError(f"{folder} holds no image that its calibration names")
    if any(camera != cameras[0] for camera in cameras):
        raise SourceError(f"{folder}: the images have different calibrations, and a sequence has one")
    order = np.argsort(stamps)
    return Converted(
        tuple(images[i] for i in order), tuple(stamps[i] for i in order), tuple(poses[i] for i in order), cameras[0]
    )


def _camera_of(K: Floats, image: Path, root: Path) -> Camera:
    height, width = read_image(image, root).shape[:2]
    return Camera("pinhole", width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def _table(path: Path, root: Path, columns: int) -> Floats:
    rows = [numbers(row, row[1].split(), columns, f"{columns} numbers") for row in read_rows(path, root)]
    if not rows:
        raise SourceError(f"{path} is empty")
    return np.array(rows)


def _matrix(path: Path, root: Path, size: int) -> Floats:
    """Read a square matrix. It may hold numbers that are not finite."""
    rows = [row[1].split() for row in read_rows(path, root)]
    try:
        matrix = np.array([[float(value) for value in row] for row in rows])
    except ValueError:
        matrix = np.zeros((0, 0))
    if matrix.shape != (size, size):
        raise SourceError(f"{path}: expected a matrix {size}x{size}")
    return matrix


def _images(folder: Path) -> list[Path]:
    images = list_images(folder)
    if len(images) > _MOST_IMAGES:
        raise SourceError(f"{folder} has more than {_MOST_IMAGES} images")
    return images


def _index(text: str) -> int:
    digits = "".join(c if c.isdigit() else " " for c in text).split()
    if not digits:
        raise SourceError(f"{text}: a file name without a number")
    return int(digits[-1])


#: The converters by the name of the layout.
LAYOUTS: dict[str, Callable[[Path], Converted]] = {
    "7scenes": _seven_scenes,
    "tartanair": _tartanair,
    "middlebury": _middlebury,
    "strecha": _strecha,
    "uzh": _uzh,
    "colmap": _readable,
    READ: _readable,
}
