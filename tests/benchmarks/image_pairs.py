"""Pairs of real images with their matches and the true pose between them.

The folder of data holds three kinds of pairs: pair sets (``pairs.json``: images, calibrations, ``T_0to1``), sequences
with a ground truth (pairs of frames some steps apart), and a chessboard whose corners are numbered (``corners.txt``).
The corners are matched by their numbers. All other matches are SIFT matches with mutual nearest neighbours and Lowe's
ratio test, as the pipeline matches photographs (:mod:`slam_init.frontend.sift`).
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quest.geometry.epipolar import depths_from_pose, sampson_error
from slam_init.config import TrackingConfig
from slam_init.datasets import TimedSource, open_source
from slam_init.datasets.image_files import read_image
from slam_init.errors import SourceError
from slam_init.frontend.sift import SiftFeatures, detect_sift, match_descriptors
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Pose

#: Data sets whose ground truth does not resolve the direction of a short baseline: its error is about ten degrees. The
#: causes are depth tracking (7-Scenes), a rolling shutter (TUM RGB-D), and no motion but a turn (panorama).
DIRECTION_UNKNOWN = ("7scenes/", "tum_rgbd/", "panorama/")
#: A sequence of a static camera, without any translation.
STATIC_SEQUENCE = "euroc/V1_01_static"
#: Excluded: a person holds the chessboard in front of a fixed camera, so no single motion explains the image.
_SEVERAL_MOTIONS = ("planar/opencv_chessboard",)
#: Pairs with a baseline shorter than this share of the longest one in the sequence are left out: noise dominates the
#: direction of such a baseline.
_SHORT_BASELINE = 0.05
#: Steps between the two images of a pair of the chessboard.
_CHESSBOARD_STEPS = (1, 2)


@dataclass(frozen=True, eq=False)
class ImagePair:
    """Matches of two images."""

    #: bearings1, bearings2: (N, 3) Unit rays.
    bearings1: Floats
    bearings2: Floats
    #: (N,) Distances of the descriptors; zero for numbered corners.
    distances: Floats
    #: Geometric mean over both cameras; converts pixels to radians.
    focal_px: float
    #: The true pose, in the units of the data.
    cam2_from_cam1: Pose


def find_sequences(data: Path) -> list[str]:
    """Return the paths below ``data`` of the sequences with a camera and a ground truth, sorted."""
    folders = (camera.parent for camera in data.rglob("camera.yaml") if (camera.parent / "groundtruth.txt").is_file())
    return sorted(name for folder in folders if (name := folder.relative_to(data).as_posix()) not in _SEVERAL_MOTIONS)


def match_features(
    camera1: Camera, features1: SiftFeatures, camera2: Camera, features2: SiftFeatures, pose: Pose
) -> ImagePair:
    """Match the features of two images; ``pose`` is the true cam2_from_cam1."""
    i, j = match_descriptors(features1.descriptors, features2.descriptors, TrackingConfig().sift_ratio)
    bearings1, bearings2 = camera1.bearings(features1.pixels[i]), camera2.bearings(features2.pixels[j])
    distances = np.linalg.norm(features1.descriptors[i] - features2.descriptors[j], axis=1)
    # Pixels outside the field of view of the lens model have no bearing.
    seen = np.isfinite(bearings1).all(axis=1) & np.isfinite(bearings2).all(axis=1)
    focal_px = float(np.sqrt(camera1.focal_px * camera2.focal_px))
    return ImagePair(bearings1[seen], bearings2[seen], distances[seen].astype(float), focal_px, pose)


def true_matches(pair: ImagePair, bearings1: Floats, bearings2: Floats, threshold_rad: float) -> Bools:
    """Return the mask (N,) of the matches that agree with the true pose and lie in front of both cameras."""
    R, t = pair.cam2_from_cam1.R, pair.cam2_from_cam1.t
    u, v = depths_from_pose(R, t, bearings1, bearings2)
    return np.asarray((np.abs(sampson_error(R, t, bearings1, bearings2)) < threshold_rad) & (u > 0) & (v > 0))


def pair_set(folder: Path) -> Iterator[ImagePair]:
    """Read the pairs of a folder with ``pairs.json``."""
    for entry in json.loads((folder / "pairs.json").read_text(encoding="utf-8")):
        if "T_0to1" not in entry:
            raise SourceError(f"{folder / 'pairs.json'}: an entry has no true pose: add T_0to1")
        T = np.array(entry["T_0to1"], float)
        cameras = [_entry_camera(entry, i) for i in (0, 1)]
        features = [_image_features(folder / entry[f"image{i}"]) for i in (0, 1)]
        yield match_features(cameras[0], features[0], cameras[1], features[1], Pose(T[:3, :3], T[:3, 3]))


def _entry_camera(entry: Mapping[str, object], i: int) -> Camera:
    """Read the calibration of image ``i``: ``width``, ``height``, the matrix ``K0`` or ``K1``, and the distortion."""
    width, height = np.array([entry["width"], entry["height"]], int).tolist()
    K = np.array(entry[f"K{i}"], float)
    distortion = tuple(np.array(entry.get(f"distortion{i}", entry.get("distortion", ())), float).tolist())
    model = "radtan" if distortion else "pinhole"
    return Camera(model, width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], distortion)


def _image_features(path: Path) -> SiftFeatures:
    return detect_sift(Frame(0, 0.0, path.name, read_image(path)).gray, TrackingConfig().sift_features)


def sequence_pairs(source: TimedSource, step: int, limit: int) -> Iterator[ImagePair]:
    """Read up to ``limit`` pairs of frames that are ``step`` apart, spread evenly over a sequence.

    Pairs without a true pose are left out, and pairs whose baseline is much shorter than the longest one as well.
    """
    if source.camera is None or source.groundtruth is None:
        raise SourceError(f"{source.name} has no calibration or no ground truth: both are needed")
    truth = [source.groundtruth.at(stamp) for stamp in source.timestamps_s]
    starts = [i for i in range(len(source) - step) if truth[i] is not None and truth[i + step] is not None]
    poses = {i: b.inverse() @ a for i in starts if (a := truth[i]) and (b := truth[i + step])}
    longest = max((np.linalg.norm(pose.t) for pose in poses.values()), default=0.0)
    moved = [i for i, pose in poses.items() if np.linalg.norm(pose.t) >= _SHORT_BASELINE * longest]
    chosen = [moved[k] for k in np.unique(np.linspace(0, len(moved) - 1, limit).round().astype(int))] if moved else []
    for i in chosen:
        first, second = (_frame_features(source, index) for index in (i, i + step))
        yield match_features(source.camera, first, source.camera, second, poses[i])


def _frame_features(source: TimedSource, index: int) -> SiftFeatures:
    frame = next(iter(source.frames(start=index, max_frames=1)))
    return detect_sift(frame.gray, TrackingConfig().sift_features)


def chessboard_pairs(folder: Path) -> Iterator[ImagePair]:
    """Read pairs of images of a chessboard, one and two images apart, matched by the numbers of the corners."""
    source = open_source(str(folder))
    if source.camera is None or source.groundtruth is None:
        raise SourceError(f"{folder} has no calibration or no ground truth: both are needed")
    corners: dict[str, dict[int, tuple[float, float]]] = {}
    for line in (folder / "corners.txt").read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            name, number, u, v = line.split()
            corners.setdefault(name, {})[int(number)] = (float(u), float(v))
    names = list(corners)
    poses = source.groundtruth.world_from_cam
    if len(poses) != len(names):
        raise SourceError(f"{folder}: {len(names)} images in corners.txt, {len(poses)} in the ground truth")
    for step in _CHESSBOARD_STEPS:
        for i in range(len(names) - step):
            first, second = corners[names[i]], corners[names[i + step]]
            both = sorted(first.keys() & second.keys())
            bearings1, bearings2 = (
                source.camera.bearings(np.array([view[corner] for corner in both])) for view in (first, second)
            )
            pose = poses[i + step].inverse() @ poses[i]
            yield ImagePair(bearings1, bearings2, np.zeros(len(both)), source.camera.focal_px, pose)
