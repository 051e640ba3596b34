"""What a layout is, and the source that is made of what a data set states of its images.

Each reader of a layout lists its images, and for each image the time stamp, the calibration and the true pose as far as
the files state them. :func:`image_sequence` checks these and makes the source. The poses of the layouts have several
conventions of the camera axes; :func:`with_axes` converts them to those of this project: x right, y down, z forward.

Photographs and rendered images have no times. :func:`photographs` puts them in the natural order of their names, one a
second.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.datasets.image_files import PHOTO_RATE_HZ, ImageFileSource, natural_key
from slam_init.datasets.inertial import InertialSensor
from slam_init.datasets.text import image_times, trajectory, truth_on_clock
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import TimedSource
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.time_stamps import TimeUnit


@dataclass(frozen=True)
class Layout:
    """A kind of folder or file."""

    #: What :func:`slam_init.datasets.opening.detect_kind` returns.
    kind: str
    #: The files that state it, and its name in brackets, for the message where nothing fits.
    looked_for: str
    #: Finds the files that a path of this kind has; None or False for another path. It reads no large file.
    find: Callable[[Path], Any]
    #: Opens a path, with what was found.
    open: Callable[[Path, Any], TimedSource]


def file_of(*names: str) -> Callable[[Path], Path | None]:
    """Make the search for the first of some files in a folder."""
    return lambda folder: next((folder / name for name in names if (folder / name).is_file()), None)


# A difference of 2 % in the focal length moves a pixel at the border, half a side from the centre, by 1 % of the side.
# The focal length of a telephone that focuses changes by less.
_MAX_SHIFT = 0.01

#: Camera axes by name, as columns in those of this project (right, down, forward).
AXES: dict[str, Floats] = {
    "right, up, backward": np.diag([1.0, -1.0, -1.0]),  # OpenGL
    "forward, right, down": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),  # aircraft
    "forward, left, up": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),  # ROS, a body
}


def with_axes(world_from_cam: Pose, axes: str) -> Pose:
    """Convert the pose of a camera whose axes are a key of :data:`AXES`."""
    return Pose(world_from_cam.R @ AXES[axes].T, world_from_cam.t)


@dataclass(frozen=True, eq=False)
class PosedImage:
    """A photograph with what a data set knows about it."""

    path: Path
    world_from_cam: Pose
    camera: Camera | None = None


def image_sequence(
    kind: str,
    root: Path,
    paths: Sequence[Path],
    *,
    name: str | None = None,
    stamps: Sequence[tuple[str, float]] = (),
    unit: TimeUnit = TimeUnit.SECONDS,
    rate_hz: float = PHOTO_RATE_HZ,
    camera: Camera | None = None,
    poses: Sequence[Pose | None] = (),
    truth: Trajectory | None = None,
    notes: tuple[str, ...] = (),
    imu: Callable[[], InertialSensor] | None = None,
) -> ImageFileSource:
    """Make a source of images in the order of their times.

    * ``root``: The folder that no image may lie outside of.
    * ``stamps``: The time stamp of each image with its place for messages, in ``unit``. Without them the images have
      the nominal rate.
    * ``poses``: The true pose of each image, where it is known.
    * ``truth``: True poses with stamps of their own, in ``unit``.
    """
    timestamps_s, time_notes = np.arange(len(paths)) / rate_hz, tuple[str, ...]()
    if stamps:
        timestamps_s, time_notes = image_times([stamp for _, stamp in stamps], [place for place, _ in stamps], unit)
    truth, truth_notes = truth_on_clock(truth, timestamps_s, unit)
    if poses:
        stamped = zip(timestamps_s.tolist(), poses, strict=True)
        truth = trajectory([(time_s, pose) for time_s, pose in stamped if pose is not None])
    name, notes = name or root.resolve().name, (*time_notes, *notes, *truth_notes)
    return ImageFileSource(name, kind, tuple(paths), timestamps_s, camera, truth, notes, root, imu)


def photographs(kind: str, root: Path, images: Sequence[PosedImage]) -> ImageFileSource:
    """Make a source of posed images without times.

    Images that the folder does not hold are left out, since data sets are often passed on in part, and so are images of
    another camera.
    """
    there = [image for image in images if image.path.is_file()]
    there.sort(key=lambda image: natural_key(image.path.as_posix()))
    if not there:
        listed = f", for example {os.path.relpath(images[0].path, root)}" if images else ""
        raise SourceError(f"{root}: holds none of the {len(images)} images that its {kind} lists{listed}")
    paths = [image.path for image in there]
    twice = next((path for path, count in Counter(paths).items() if count > 1), None)
    if twice is not None:
        raise SourceError(f"{root}: its {kind} lists {os.path.relpath(twice, root)} twice")
    missing = len(images) - len(paths)
    notes = (f"{missing} of {len(images)} listed images are not in the folder",) if missing else ()
    camera, kept, camera_notes = common_camera([image.camera for image in there], str(root))
    poses = [image.world_from_cam for image in compress(there, kept)]
    notes = (*notes, *camera_notes)
    return image_sequence(kind, root, list(compress(paths, kept)), camera=camera, poses=poses, notes=notes)


def common_camera(cameras: Sequence[Camera | None], what: str) -> tuple[Camera | None, list[bool], tuple[str, ...]]:
    """Find one calibration for images that state one each.

    The images must be of one camera. Calibrations that differ by less than one per cent of the longer side, as those
    of a telephone that focuses, are replaced by their median; the note states how much they differ.
    """
    stated = [camera for camera in cameras if camera is not None]
    if not stated:
        return None, [True] * len(cameras), ()
    kinds = [(camera.model, camera.width, camera.height, len(camera.distortion)) for camera in stated]
    (kind, _), *_ = Counter(kinds).most_common(1)  # of equal ones the first
    model, width, height, _ = kind
    alike = [camera for camera, its_kind in zip(stated, kinds, strict=True) if its_kind == kind]
    fx, fy, cx, cy, *distortion = np.median([c.parameters for c in alike], axis=0).tolist()
    median = Camera(model, width, height, fx, fy, cx, cy, tuple(distortion))
    (commonest, _), *_ = Counter(alike).most_common(1)
    bound_px = _MAX_SHIFT * max(width, height)
    # A median of two groups of cameras is that of neither.
    choices = [(choice, {c: _largest_shift_px(c, choice) for c in set(alike)}) for choice in (median, commonest)]
    common, shifts = max(choices, key=lambda choice: sum(choice[1][camera] <= bound_px for camera in alike))
    kept = [camera is not None and shifts.get(camera, np.inf) <= bound_px for camera in cameras]
    if sum(kept) < min(2, len(cameras)):
        raise CalibrationError(f"{what}: the images are of different cameras: give images of one camera")
    notes = []
    if sum(kept) < len(kept):
        notes.append(f"{len(kept) - sum(kept)} of {len(kept)} images are of another camera, and are left out")
    largest_px = max(shifts[camera] for camera, keep in zip(cameras, kept, strict=True) if keep and camera is not None)
    if largest_px > 0:
        notes.append(f"the images state calibrations that differ by up to {largest_px:.1f} px: one is used for all")
    return common, kept, tuple(notes)


def _largest_shift_px(camera: Camera, other: Camera) -> float:
    """How far a pixel moves if it is seen by the one camera and projected by the other."""
    if camera == other:
        return 0.0
    columns, rows = np.linspace(0, camera.width - 1, 5), np.linspace(0, camera.height - 1, 5)
    pixels: Floats = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    shift = np.linalg.norm(other.project(camera.bearings(pixels)) - pixels, axis=1)
    seen = shift[np.isfinite(shift)]
    return float(seen.max()) if len(seen) else np.inf
