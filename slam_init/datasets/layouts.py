"""Folders of posed images, as the data sets of this field are published.

A layout finds its files, and lists the images with what the files state of each;
:func:`slam_init.datasets.posed_images.image_sequence` makes the source. The sequences with a list of their images and a
trajectory with times of its own are TUM RGB-D and EuRoC, those of vehicles KITTI odometry and TartanAir. COLMAP,
nerfstudio and instant-ngp, and TrakMark have poses and no times.

**TUM RGB-D**, ICL-NUIM in its TUM-compatible form, and ETH3D SLAM:

* ``rgb.txt`` (``timestamp filename``), or ``associations.txt`` (``timestamp filename timestamp filename``, colour and
  depth in either order);
* ``groundtruth.txt`` (``timestamp tx ty tz qx qy qz qw``, world_from_cam), optional;
* ``camera.yaml``, the calibration, optional; or ``calibration.txt`` of ETH3D SLAM: ``fx fy cx cy``, where the centre of
  the first pixel is at 0. Without them the published calibrations are used: for ICL-NUIM, and for TUM
  RGB-D where the name of the folder holds ``freiburg1``, ``freiburg2`` or ``freiburg3``.

ICL-NUIM is rendered in a frame whose y axis points up, which its authors write as a negative focal length ``fy``. Its
TUM-compatible images are stored from top to bottom like all others. Therefore the camera has ``fy = +480`` here, and
the poses of ``*.gt.freiburg`` are reflected: with ``F = diag(1, -1, 1)``, ``R <- F R F``, ``t <- F t``. The first
column of its files is a frame number, which is converted to seconds at the published 30 Hz.

**EuRoC MAV** (the ASL folder layout):

* ``mav0/cam0/data.csv`` lists ``timestamp [ns],filename``.
* ``mav0/cam0/sensor.yaml`` holds the calibration and ``T_BS`` (body_from_cam).
* ``mav0/imu0`` holds rates and accelerations in ``data.csv`` (``timestamp [ns],w_x,w_y,w_z [rad/s],a_x,a_y,a_z
  [m/s^2]``), its own ``T_BS`` (body_from_imu) and its noise densities in ``sensor.yaml``. The folder is optional.
* ``mav0/state_groundtruth_estimate0/data.csv`` holds the poses world_from_body.

**KITTI odometry**

* ``sequences/NN/image_0`` (to ``image_3``) holds the images, ``sequences/NN/times.txt`` their time stamps.
* ``sequences/NN/calib.txt`` holds the projection matrices ``P0`` to ``P3``. With ``P_i = K [I | t]``, the pose
  ``cam_i_from_cam0`` is the translation t.
* ``poses/NN.txt`` beside ``sequences``, or ``poses.txt`` in the sequence, holds 3x4 matrices world_from_cam0.

**TartanAir**

* ``image_left/*.png`` with ``pose_left.txt`` (the first version), or ``image_lcam_front`` with ``pose_lcam_front.txt``
  (the second one): a line of ``tx ty tz qx qy qz qw`` for each image.
* The axes of world and camera are north, east, down: the camera looks along x, y points to the right, z down.
* All cameras are alike: a field of view of 90 degrees across, published as f = 320, c = (320, 240) for 640x480 pixels.

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
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from slam_init.calibration.files import as_text, camera_of, load_camera, load_yaml
from slam_init.calibration.values import Section, at_place, parse_json
from slam_init.datasets import image_files, text
from slam_init.datasets.colmap import model_files, read_model
from slam_init.datasets.inertial import InertialSensor, pose_of_yaml, read_densities, read_samples
from slam_init.datasets.posed_images import Layout, PosedImage, file_of, image_sequence, photographs, with_axes
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import as_array
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.time_stamps import TimeUnit, in_seconds, time_unit

# -- TUM RGB-D and EuRoC ---------------------------------------------------------------------------


#: Files that list the images of TUM RGB-D; the first that exists is read.
TUM_INDEX = ("rgb.txt", "associations.txt", "associated.txt")
# Published with the data sets: the colour cameras of the three Kinects of TUM RGB-D (the images of the third one are
# already undistorted), and the renderer of ICL-NUIM.
_FREIBURG_LENSES = {
    "1": (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    "2": (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
}
_FREIBURG = {
    "1": Camera("radtan", 640, 480, 517.306408, 516.469215, 318.64304, 255.313989, _FREIBURG_LENSES["1"]),
    "2": Camera("radtan", 640, 480, 520.908620, 521.007327, 325.141442, 249.701764, _FREIBURG_LENSES["2"]),
    "3": Camera("pinhole", 640, 480, 535.4, 539.2, 320.1, 247.6),
}
_ICL_NUIM = Camera("pinhole", 640, 480, 481.2, 480.0, 319.5, 239.5)
_ICL_NUIM_RATE_HZ = 30.0


def _read_list(
    path: Path, folder: Path, images: Path, fields_of_image: Callable[[text.Row], list[str]], what: str
) -> tuple[list[Path], list[tuple[str, float]]]:
    """The images of a list, and the time stamp of each with the place of its line.

    * ``images``: Holds the images; an absolute name stays what it is.
    * ``fields_of_image``: Makes of a line the time stamp and the file name.
    """
    paths: list[Path] = []
    stamps: list[tuple[str, float]] = []
    for row in text.read_rows(path, folder if path.is_relative_to(folder) else None):
        fields = fields_of_image(row)
        stamps.append((row[0], text.stamp_of(row, fields, what)))
        if len(fields) < 2 or not fields[1]:
            raise SourceError(f"{row[0]}: expected {what}, found {row[1][:60]!r}")
        paths.append(images / fields[1])
    if not paths:
        raise SourceError(f"{path}: lists no image")
    return paths, stamps


def open_tum(folder: Path, index: Path) -> image_files.ImageFileSource:
    """Open a TUM RGB-D or ICL-NUIM folder."""
    reflected = sorted(folder.glob("*.gt.freiburg"))
    if len(reflected) > 1:
        raise SourceError(f"{folder}: several *.gt.freiburg: keep the one that belongs to the images")
    split = _time_and_name if index.name == "rgb.txt" else _colour_of_pair
    paths, stamps = _read_list(index, folder, folder, split, "a timestamp and a file name")
    camera = image_files.stored_camera(folder, paths[0], "camera.yaml", "calibration.txt")
    truth: Trajectory | None = None
    if reflected:
        stamps = [(place, stamp / _ICL_NUIM_RATE_HZ) for place, stamp in stamps]
        camera, truth = camera or _ICL_NUIM, text.read_trajectory(reflected[0], folder)
        truth = _reflected(truth) if truth else None
    else:
        named = re.search(r"freiburg([123])", folder.resolve().name)
        camera = camera or (_FREIBURG[named[1]] if named else None)
        if (folder / "groundtruth.txt").exists():
            truth = text.read_trajectory(folder / "groundtruth.txt", folder)
    return image_sequence("tum", folder, paths, stamps=stamps, camera=camera, truth=truth)


def _time_and_name(row: text.Row) -> list[str]:
    return row[1].split(maxsplit=1)  # a name may hold spaces


def _colour_of_pair(row: text.Row) -> list[str]:
    fields = row[1].split()
    return fields[2:] if len(fields) >= 4 and fields[1].lower().startswith("depth") else fields


def _reflected(truth: Trajectory) -> Trajectory:
    """The poses of ICL-NUIM for world and camera frames whose y axes point down, with times in seconds."""
    F = np.diag([1.0, -1.0, 1.0])
    poses = tuple(Pose(F @ pose.R @ F, F @ pose.t) for pose in truth.world_from_cam)
    return Trajectory(truth.timestamps_s * (1 / _ICL_NUIM_RATE_HZ), poses)


def find_euroc(folder: Path) -> Path | None:
    """Find the folder that holds the ``data.csv`` of the first camera."""
    candidates = (folder / "mav0" / "cam0", folder / "cam0", folder)
    return next((candidate for candidate in candidates if (candidate / "data.csv").is_file()), None)


def open_euroc(folder: Path, found: Path) -> image_files.ImageFileSource:
    """Open a EuRoC sequence, or its first camera."""
    cam0 = found.resolve()
    # The camera of a sequence has its ground truth beside it, so that the folder of the camera alone names its parent.
    root = cam0.parent if found == folder else folder
    paths, stamps = _read_list(cam0 / "data.csv", root, cam0 / "data", text.fields_of, "timestamp,filename")
    camera, body_from_cam = None, None
    sensor = cam0 / "sensor.yaml"
    if sensor.exists():
        check_inside(sensor, root)
        camera = replace(load_camera(sensor, image_files.image_size(paths[0], root)), source="machine")
        body_from_cam = _body_from(sensor, load_yaml(sensor))
    mav = cam0.parent
    truth_file = mav / "state_groundtruth_estimate0" / "data.csv"
    truth: Trajectory | None = None
    if truth_file.exists():
        columns = "timestamp tx ty tz qw qx qy qz"
        truth = text.read_trajectory(truth_file, root, columns, body_from_cam or Pose.identity())
    imu, notes, stated = None, tuple[str, ...](), TimeUnit.NANOSECONDS
    if (mav / "imu0" / "data.csv").exists():
        if body_from_cam is not None and (mav / "imu0" / "sensor.yaml").exists():
            unit = time_unit(np.array([stamp for _, stamp in stamps]), stated)
            imu = partial(_read_imu0, mav / "imu0", root, body_from_cam, unit)
        else:
            notes = ("imu0 is not used: no sensor.yaml states its rotation against the camera (T_BS)",)
    name = mav.parent.name if mav.name == "mav0" else mav.name
    return image_sequence(
        "euroc", root, paths, name=name, stamps=stamps, unit=stated, camera=camera, truth=truth, notes=notes, imu=imu
    )


def _body_from(sensor: Path, stated: Mapping[str, object]) -> Pose | None:
    """The pose ``T_BS`` of a sensor in the body; None where it is not stated."""
    entry = stated.get("T_BS")
    data = entry.get("data") if isinstance(entry, dict) else entry
    return None if data is None else pose_of_yaml(f"{sensor}: T_BS", data)


def _read_imu0(folder: Path, root: Path, body_from_cam: Pose, unit: TimeUnit) -> InertialSensor:
    """The inertial sensor; its stamps have the unit of those of the images."""
    sensor = folder / "sensor.yaml"
    check_inside(sensor, root)
    stated = load_yaml(sensor)
    body_from_imu = _body_from(sensor, stated)
    if body_from_imu is None:
        raise SourceError(f"{sensor}: no T_BS, the pose of the sensor: add it, or leave --imu out")
    stamps, samples = read_samples(folder / "data.csv", root, "timestamp,w_x,w_y,w_z (rad/s),a_x,a_y,a_z (m/s^2)")
    cam_from_imu, densities = body_from_cam.inverse() @ body_from_imu, read_densities(sensor, Section(stated))
    return InertialSensor.made(in_seconds(stamps, unit), samples, cam_from_imu, densities, name="imu0")


# -- KITTI and TartanAir ---------------------------------------------------------------------------


# Frame rate where no file states times: the cameras of KITTI were triggered at 10 Hz, and TartanAir is rendered at it.
_NOMINAL_RATE_HZ = 10.0

_TARTANAIR = (("image_left", "pose_left.txt"), ("image_lcam_front", "pose_lcam_front.txt"))


def find_kitti(folder: Path) -> Path | None:
    """Find the image folder of a sequence: the left grey camera, or else the left colour camera."""
    for name in ("image_0", "image_2"):
        if (folder / name).is_dir():
            return folder / name
    resolved = folder.resolve()
    beside = any((resolved.parent / name).is_file() for name in ("calib.txt", "times.txt"))
    return resolved if beside and re.fullmatch(r"image_[0-3]", resolved.name) else None


def open_kitti(folder: Path, found: Path) -> image_files.ImageFileSource:
    """Open a KITTI odometry sequence, or the images of one of its cameras."""
    images = found.resolve()
    sequence = images.parent
    if found.parent == folder:  # the sequence is named, and not its images
        check_inside(found, folder)
    paths = image_files.list_images(images)
    times, stamps = sequence / "times.txt", []
    if times.exists():
        stamps = [
            (row[0], text.stamp_of(row, text.fields_of(row), "a time in seconds"))
            for row in text.read_rows(times, sequence)
        ]
        text.check_count(times, stamps, "times", paths)
    camera, cam0_from_cam = None, Pose.identity()
    if (sequence / "calib.txt").exists():
        size = image_files.image_size(paths[0], sequence)
        camera, cam0_from_cam = _rectified(sequence / "calib.txt", sequence, f"P{images.name[-1]}", size)
    poses: list[Pose] = []
    beside = sequence.parent.parent
    for path, root in ((beside / "poses" / f"{sequence.name}.txt", beside), (sequence / "poses.txt", sequence)):
        if path.exists():
            poses = [pose @ cam0_from_cam for pose in text.read_poses_of(paths, path, root)]
            break
    camera, name = image_files.stored_camera(sequence, paths[0]) or camera, f"{sequence.name}/{images.name}"
    return image_sequence(
        "kitti", sequence, paths, name=name, stamps=stamps, rate_hz=_NOMINAL_RATE_HZ, camera=camera, poses=poses
    )


def _rectified(path: Path, root: Path, key: str, size: tuple[int, int]) -> tuple[Camera, Pose]:
    """The camera of a projection matrix ``K [I | t]``, and its pose cam0_from_cam."""
    for row in text.read_rows(path, root):
        name, _, rest = row[1].partition(":")
        if name.strip() == key:
            values = np.array(text.numbers(row, rest.split(), 12, f"{key}: and 12 numbers")).reshape(3, 4)
            if not (values[2, 2] > 0 and np.abs(values).max() <= 1e100 * values[2, 2]):
                raise SourceError(f"{row[0]}: {key} is no projection matrix [fx 0 cx, 0 fy cy, 0 0 1 | K t]")
            values = values / values[2, 2]
            K = values[:, :3]
            camera = camera_of(f"{row[0]}: {key}", {"K": K.ravel().tolist(), "resolution": list(size)})
            cam_from_cam0 = Pose(np.eye(3), np.asarray(np.linalg.solve(K, values[:, 3]), float))
            return replace(camera, source="machine"), cam_from_cam0.inverse()
    raise SourceError(f"{path}: no line {key}:")


def find_tartanair(folder: Path) -> tuple[Path, Path] | None:
    """Find the images and the poses of a sequence."""
    found = ((folder / images, folder / poses) for images, poses in _TARTANAIR)
    return next(((images, poses) for images, poses in found if images.is_dir() and poses.is_file()), None)


def open_tartanair(folder: Path, found: tuple[Path, Path]) -> image_files.ImageFileSource:
    """Open a TartanAir sequence."""
    paths = image_files.list_images(found[0])
    stated = text.read_poses_of(paths, found[1], folder, "tx ty tz qx qy qz qw")
    poses = [with_axes(pose, "forward, right, down") for pose in stated]
    width, height = image_files.image_size(paths[0], folder)
    published = Camera("pinhole", width, height, width / 2, width / 2, width / 2, height / 2, source="machine")
    camera = image_files.stored_camera(folder, paths[0]) or published
    return image_sequence("tartanair", folder, paths, rate_hz=_NOMINAL_RATE_HZ, camera=camera, poses=poses)


# -- images without times --------------------------------------------------------------------------


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


# A million poses with file names have 100 to 400 MB as JSON; the largest scenes in use have a few thousand.
_MAX_JSON_BYTES = 100_000_000


def find_colmap(folder: Path) -> Path | None:
    """Find the folder of a model: the folder itself, a usual place below it, or else the first folder in it."""
    usual = [folder, *(folder / place for place in _COLMAP_PLACES)]
    # Other names only where there are images for the model: the folder may be one of many sequences.
    below = sorted(entry for entry in folder.iterdir() if entry.is_dir()) if (folder / "images").is_dir() else []
    return next((place for place in (*usual, *below) if model_files(place)), None)


def open_colmap(folder: Path, model: Path) -> image_files.ImageFileSource:
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


def _open_transforms(folder: Path, path: Path) -> image_files.ImageFileSource:
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
        image = folder / frame["file_path"]
        if image.suffix.lower() not in image_files.IMAGE_SUFFIXES:  # Blender's scenes name an image without its suffix
            image = image.with_name(image.name + ".png")
        what, give = f"{place}: transform_matrix", "4x4 finite numbers"
        matrix = as_array(frame.get("transform_matrix"), np.float64, (None, 4), what, give, SourceError)
        if len(matrix) not in (3, 4):
            raise SourceError(f"{what} has {len(matrix)} rows: give {give}")
        stated = {key: frame.get(key, content.get(key)) for key in _INTRINSICS}
        key = repr(stated)
        if key not in cameras:
            if size is None and (stated["w"] is None or stated["h"] is None) and image.is_file():
                size = image_files.image_size(image, folder)
            given: dict[str, object] = {name: value for name, value in stated.items() if value is not None}
            cameras[key] = _transforms_camera(place, given, size)
        yield PosedImage(image, with_axes(text.pose_from_matrix(place, matrix), "right, up, backward"), cameras[key])


def _transforms_camera(place: str, stated: dict[str, object], size: tuple[int, int] | None) -> Camera | None:
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
    lens: dict[str, object] = {key: stated.get(key, 0.0) for key in _COEFFICIENTS}
    lens |= {"is_fisheye": stated["is_fisheye"]} if stated.get("is_fisheye") else {"model": name}
    camera = camera_of(place, {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy} | lens)
    if camera.model == "rational":
        raise CalibrationError(f"{place}: k4 is not supported for a perspective camera: use k1, k2, k3, p1, p2")
    return camera


def _named(word: str, folder: Path) -> Path | None:
    """Find the table of a sequence whose name has a word."""
    found = (path for path in sorted(folder.glob("*")) if word in path.name.lower() and path.suffix in _TRAKMARK_TABLES)
    return next((path for path in found if path.is_file()), None)


def open_trakmark(folder: Path, extrinsics: Path) -> image_files.ImageFileSource:
    """Open a sequence in the manner of TrakMark."""
    paths = image_files.list_images(image_files.image_folder(folder) or folder)
    poses = [pose.inverse() for pose in text.read_poses_of(paths, extrinsics, folder)]
    intrinsics = _named("intrinsic", folder)
    camera = image_files.stored_camera(folder, paths[0], "camera.yaml", *([intrinsics.name] if intrinsics else []))
    return image_sequence("trakmark", folder, paths, rate_hz=image_files.NOMINAL_RATE_HZ, camera=camera, poses=poses)


#: All layouts. They are tried in this order, which is that of ``docs/how-to/data-sets.md``.
LAYOUTS = (
    Layout("tum", f"{', '.join(TUM_INDEX)} (TUM)", file_of(*TUM_INDEX), open_tum),
    Layout("euroc", "mav0/cam0/data.csv (EuRoC)", find_euroc, open_euroc),
    Layout("kitti", "image_0 or image_2 (KITTI)", find_kitti, open_kitti),
    Layout("tartanair", "image_left with pose_left.txt (TartanAir)", find_tartanair, open_tartanair),
    Layout("transforms", f"{TRANSFORMS[0]} (nerfstudio, instant-ngp)", file_of(*TRANSFORMS), _open_transforms),
    Layout("colmap", "cameras and images, .txt or .bin, perhaps in sparse/0 (COLMAP)", find_colmap, open_colmap),
    Layout("trakmark", "a table *extrinsic* (TrakMark)", partial(_named, "extrinsic"), open_trakmark),
)
