"""Reads a map from anywhere, to be audited: its poses, its calibration, and the tracks of its points.

* ``handover.npz``, or the folder of a run that has one;
* the folder of a COLMAP model, text or binary, with the observations of its points;
* ``graph.txt`` of gtsam with ``values.txt`` beside it, or their folder, with the measurements of its factors;
* ``transforms.json`` of nerfstudio: poses and the names of their images;
* a trajectory: poses and no tracks. Its columns are those that a header names, otherwise those of TUM RGB-D, as
  ORB-SLAM writes of its keyframes, or the matrices of KITTI, a line for each image.

The tracks of the points of a map are those that the map has kept. Those of a source, its images or its matches, are not
chosen by the map, so that a wrong map is found more often.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_init.bundle.graph import map_of_graph
from slam_init.calibration.values import at_place
from slam_init.config import Config
from slam_init.datasets import text
from slam_init.datasets.colmap import read_model
from slam_init.datasets.image_files import ImageFileSource, check_size, find_by_end, natural_key
from slam_init.datasets.layouts import TRANSFORMS, find_colmap, read_transforms
from slam_init.datasets.posed_images import common_camera, file_of
from slam_init.datasets.track_source import TrackProvider, TrackSource, TrackTable, read_npz
from slam_init.errors import SourceError
from slam_init.frontend.tracks import Tracker
from slam_init.output.handover import FORMAT, VERSION
from slam_init.output.results import load_graph
from slam_init.system.regular_file import kind_problem
from slam_init.types.arrays import Floats, Ints, as_array
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations, TimedSource
from slam_init.types.pose import Pose, Trajectory

_HANDOVER, _GRAPH, _VALUES = "handover.npz", "graph.txt", "values.txt"
#: The arrays of ``handover.npz`` that are read.
_ARRAYS = (
    *("format", "version", "camera_model", "camera_size", "camera_parameters", "keyframe_frames", "keyframe_poses"),
    *("point_ids", "observation_keyframes", "observation_points", "observation_pixels"),
)
#: A map of a million observations has 32 MB.
_MAX_BYTES = 500_000_000
_OTHER_SIZE = "give the images of the map, or their calibration by --camera"
#: Frames of a source from the first pose on: ten seconds of video, in which a first map is made.
_MOST_FRAMES = 300


@dataclass(frozen=True, eq=False)
class MapFile:
    """A map as its files state it."""

    path: Path
    world_from_cam: tuple[Pose, ...]
    #: The frames of the poses, or the lines of a trajectory without times; empty where only times are known.
    frames: tuple[int, ...] = ()
    #: The images of the poses; empty where the frames are those of a source, or only times are known.
    names: tuple[str, ...] = ()
    camera: Camera | None = None
    #: The tracks of the points; None where the files have none.
    table: TrackTable | None = None
    #: By time.
    trajectory: Trajectory | None = None
    #: Holds the images that the map names; None where it names none.
    images: Path | None = None

    @property
    def is_trajectory(self) -> bool:
        """Whether the file has poses alone: no format states what they mean."""
        return self.table is None and not self.names

    @property
    def poses(self) -> dict[int, Pose]:
        """World_from_cam by frame."""
        return dict(zip(self.frames, self.world_from_cam, strict=True))

    def tracks(self, camera: Camera) -> list[Observations]:
        """The tracks of the points of the map in its frames; none where it has no points."""
        if (table := self.table) is None:
            return []
        # A graph of gtsam has a guess of the size. What lies a whole image beside the image is no observation.
        size = np.array([camera.width, camera.height])
        near = ((table.pixels > -size) & (table.pixels < 2 * size)).all(axis=1)
        rows = {frame: np.flatnonzero((table.frames == frame) & near) for frame in self.frames}
        return [Observations(k, float(k), str(k), *table.seen(seen, camera)) for k, seen in rows.items()]


def open_map(path: Path) -> MapFile:
    """Read a map: a file or a folder of one of the kinds above."""
    if path.is_file():
        of_suffix = {".npz": _handover, ".json": _transforms}.get(path.suffix.lower())
        if of_suffix is not None:
            return of_suffix(path)
        return _graph(path.parent) if path.name == _GRAPH else _trajectory(path)
    if not path.is_dir():
        problem = (path.exists() and kind_problem(path)) or "no such map"
        raise SourceError(f"{path}: {problem}: give handover.npz, a folder, or a trajectory")
    if (path / _HANDOVER).is_file():
        return _handover(path / _HANDOVER)
    if (model := find_colmap(path)) is not None:
        return _colmap(path, model)
    if (path / _GRAPH).is_file() and (path / _VALUES).is_file():
        return _graph(path)
    if listed := file_of(*TRANSFORMS)(path):
        return _transforms(listed)
    looked_for = f"{_HANDOVER}, cameras and images of COLMAP, {_GRAPH} of gtsam and {TRANSFORMS[0]}"
    raise SourceError(f"{path}: holds no map: looked for {looked_for} (run --restart has some in segment-001)")


def tracked_by(
    map_: MapFile, source: TimedSource, camera: Camera, config: Config
) -> tuple[dict[int, Pose], list[Observations], tuple[str, ...]]:
    """The poses of a map by the frames of a source, the tracks of the source from the first of them on, and notes."""
    poses, notes = _in_source(map_, source)
    if len(poses) < 2:
        clocks = "" if map_.trajectory is None else f" ({_clocks(map_.trajectory.timestamps_s, source.timestamps_s)})"
        raise SourceError(f"{map_.path}: {len(poses)} poses belong to images of {source.name}{clocks}: give its images")
    tracker = Tracker(camera, config.tracking, history_limit=_MOST_FRAMES)
    views = []
    for frame in source.frames(min(poses), _MOST_FRAMES):
        if isinstance(source, TrackProvider):
            views.append(source.observed(frame, camera))
        else:
            size, expected = frame.image.shape[1::-1], (camera.width, camera.height)
            check_size(source.name, size, expected, "the calibration", otherwise=_OTHER_SIZE)
            tracker.track(frame)
    return poses, views or list(tracker.history), notes


def moves_otherwise(
    map_: MapFile, poses: Mapping[int, Pose], views: Sequence[Observations], pair: Sequence[int]
) -> bool:
    """Whether the points of a map move otherwise in the images of a source: then these are no images of the map.

    Between two frames a point of the map moves as the map has observed it, right or wrong as its poses may be. In its
    own images the nearest track moves alike. Where such tracks predict the motion of the middle point no better than
    the assumption that it does not move, they are of another scene. Without points that both frames see no answer is
    known.

    * ``poses``: Of the frames of the source.
    * ``pair``: Two frames of the source.
    """
    if map_.table is None:
        return False
    from scipy.spatial import cKDTree

    by_frame, of_map, of_source = {view.frame: view for view in views}, [], []
    for frame in pair:
        own = next(k for k, pose in zip(map_.frames, map_.world_from_cam, strict=True) if pose is poses[frame])
        rows = map_.table.frames == own
        of_map.append((map_.table.track_ids[rows], map_.table.pixels[rows]))
        of_source.append((by_frame[frame].track_ids, by_frame[frame].pixels))
    places, moved = _moved(*of_map)
    near, moved_near = _moved(*of_source)
    if not len(places) or not len(near):
        return False
    off = moved_near[cKDTree(near).query(places)[1]] - moved
    return bool(np.median(np.linalg.norm(off, axis=1)) > np.median(np.linalg.norm(moved, axis=1)))


def _moved(first: tuple[Ints, Floats], second: tuple[Ints, Floats]) -> tuple[Floats, Floats]:
    """The pixels (N, 2) of common tracks in the first of two frames, and how they move to the second."""
    _, i, j = np.intersect1d(first[0], second[0], return_indices=True)
    return first[1][i], second[1][j] - first[1][i]


def _in_source(map_: MapFile, source: TimedSource) -> tuple[dict[int, Pose], tuple[str, ...]]:
    """The poses of a map by the frames of a source: by time, by the names of the images, or by their numbers."""
    if map_.trajectory is not None:
        return _by_time(map_.trajectory, source.timestamps_s)
    if not map_.names:
        if map_.is_trajectory and len(map_.frames) != len(source):
            counts = f"{len(map_.frames)} poses without times for {len(source)} images"
            raise SourceError(f"{map_.path}: {counts}: state the time of each pose, or give a pose for each image")
        return {frame: pose for frame, pose in map_.poses.items() if frame < len(source)}, ()
    found = find_by_end(map_.names, _names_of(source))
    named = zip(found, map_.world_from_cam, strict=True)
    return {candidates[0]: pose for candidates, pose in named if len(candidates) == 1}, ()


def _by_time(known: Trajectory, times_s: Floats) -> tuple[dict[int, Pose], tuple[str, ...]]:
    """The poses by the images of their times. Clocks that differ by an offset, and numbers of images, are noted."""
    stamped, notes = text.truth_on_clock(known, times_s)[0] or known, tuple[str, ...]()
    # A pose belongs to one image: at 60 images a second the next ones are near in time as well.
    apart_s = np.abs(times_s[:, None] - stamped.timestamps_s)
    frames, near = apart_s.argmin(axis=0), apart_s.min(axis=0) <= text.TOLERANCE_S
    stamps, clocks = known.timestamps_s, _clocks(known.timestamps_s, times_s)
    if not near.all() and text.line_by_line(stamps, times_s):
        frames, near, notes = np.arange(len(stamps)), np.ones(len(stamps), bool), (f"{clocks}: taken line by line",)
    elif near.sum() < 2 and not (stamps % 1).any() and stamps[0] >= 0 and stamps[-1] < len(times_s):
        frames, near, notes = stamps.astype(int), np.ones(len(stamps), bool), (f"{clocks}: taken as numbers of images",)
    elif not near.all():
        notes = (f"{(~near).sum()} of {len(near)} poses have the time of no image ({clocks})",)
    found = zip(frames.tolist(), near.tolist(), known.world_from_cam, strict=True)
    return {frame: pose for frame, belongs, pose in found if belongs}, notes


def _clocks(stamps: Floats, times_s: Floats) -> str:
    first, last, from_s, to_s = (f"{time:.12g}" for time in (stamps[0], stamps[-1], times_s[0], times_s[-1]))
    return f"time stamps of {first} to {last}, and images of {from_s} to {to_s} s"


def _names_of(source: TimedSource) -> list[str]:
    """The names of the images of a source."""
    if isinstance(source, ImageFileSource):
        return [path.as_posix() for path in source.paths]
    numbered = (f"frame-{k:06d}" for k in range(len(source)))
    return list(source.image_names if isinstance(source, TrackSource) else numbered)


def _trajectory(path: Path) -> MapFile:
    rows = list(text.read_poses(path, None, text.TUM_COLUMNS))
    if not rows:
        raise SourceError(f"{path}: holds no pose: give a map, or a trajectory: {text.TUM_COLUMNS}")
    stamps, poses = text.stamps_of(rows), tuple(pose for _, pose in rows)
    if stamps is None or 2 * len(set(stamps)) <= len(stamps):  # equal stamps are no times
        return MapFile(path, poses, tuple(range(len(poses))))
    return MapFile(path, poses, trajectory=text.trajectory(zip(stamps, poses, strict=True)))


def _transforms(path: Path) -> MapFile:
    images = list(read_transforms(path, path.parent))
    camera, kept, _ = common_camera([image.camera for image in images], str(path))
    images = list(compress(images, kept))
    poses = tuple(image.world_from_cam for image in images)
    names = tuple(image.path.as_posix() for image in images)
    return MapFile(path, poses, tuple(range(len(images))), names, camera, images=path.parent)


def _graph(folder: Path) -> MapFile:
    graph, values = load_graph(folder)
    try:
        found = map_of_graph(graph, values)
    except SourceError as error:
        raise SourceError(f"{folder}: {error}") from None
    frames = sorted(found.world_from_cam)
    poses = tuple(found.world_from_cam[k] for k in frames)
    table = _table(found.frames, found.track_ids, found.pixels)
    return MapFile(folder, poses, tuple(frames), camera=found.camera, table=table)


def _colmap(folder: Path, model: Path) -> MapFile:
    images, cameras = read_model(model, folder)
    images = sorted(images, key=lambda image: natural_key(image.name))
    camera, kept, _ = common_camera([cameras[image.camera_id] for image in images], str(folder))
    images = list(compress(images, kept))
    pixels, ids = zip(*(image.keypoints() for image in images), strict=True)
    frames = np.repeat(np.arange(len(images)), [len(some) for some in ids])
    poses = tuple(image.cam_from_world.inverse() for image in images)
    names = tuple(image.name for image in images)
    table = _table(frames, np.concatenate(ids), np.concatenate(pixels))
    return MapFile(folder, poses, tuple(range(len(images))), names, camera, table)


def _table(frames: Ints, track_ids: Ints, pixels: Floats) -> TrackTable:
    """The tracks of some observations by frame and id; of two observations of a point in a frame the first is kept."""
    seen = np.flatnonzero((track_ids >= 0) & np.isfinite(pixels).all(axis=1))
    _, first = np.unique(np.stack([frames[seen], track_ids[seen]]), axis=1, return_index=True)
    rows = seen[first]
    return TrackTable(frames[rows], track_ids[rows], pixels[rows])


def _handover(path: Path) -> MapFile:
    arrays = read_npz(path, _ARRAYS, _MAX_BYTES, "the handover.npz of slam-init run")

    def array(name: str, kind: type, *shape: int | None) -> NDArray[Any]:
        return as_array(arrays[name], kind, shape, f"{path}: {name}", error=SourceError)

    if str(arrays["format"]) != FORMAT or str(arrays["version"]) != str(VERSION):
        raise SourceError(f"{path}: is no {FORMAT} of version {VERSION}: give that of slam-init run")
    width, height = array("camera_size", np.int64, 2).tolist()
    indices = ("keyframe_frames", "point_ids", "observation_keyframes", "observation_points")
    frames, ids, keyframes, points = (array(name, np.int64, None) for name in indices)
    pixels, matrices = array("observation_pixels", np.float64, None, 2), array("keyframe_poses", np.float64, None, 4, 4)
    parameters = array("camera_parameters", np.float64, None).tolist()
    fits = len(parameters) >= 4 and len(frames) == len(matrices) and len(keyframes) == len(points) == len(pixels)
    if not fits or not all(((k >= 0) & (k < n)).all() for k, n in ((keyframes, len(frames)), (points, len(ids)))):
        raise SourceError(f"{path}: its arrays do not fit together: run again")
    if len(np.unique(frames)) < len(frames) or (frames < 0).any():
        raise SourceError(f"{path}: keyframe_frames has a frame twice, or a negative one: run again")
    fx, fy, cx, cy, *distortion = parameters
    with at_place(path):
        camera = Camera(str(arrays["camera_model"]), width, height, fx, fy, cx, cy, tuple(distortion))
    poses = tuple(text.pose_from_matrix(f"{path}: pose {k}", matrix[:3]) for k, matrix in enumerate(matrices))
    table = _table(frames[keyframes], ids[points], pixels)
    return MapFile(path, poses, tuple(frames.tolist()), camera=camera, table=table)
