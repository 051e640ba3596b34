"""Sources of tracks: features and matches of other programs, with or without the images.

A ``.npz`` file of any front end has ``frame`` (M,), ``track`` (M,), ``xy`` (M, 2) and ``size`` (2,). Optional are
``names`` (F,), ``timestamps_s`` (F,), ``K`` (3, 3) with ``distortion`` and ``model``, and ``world_from_cam`` (F, 4, 4),
the true poses; ``docs/how-to/matches.md`` has this schema.

The matches of image pairs are chained to tracks. A track is a connected set of keypoints. Two keypoints of one image
cannot see one point, so a set with two of them holds a wrong match. Such sets are chained again, one match after the
other: matches of near images first, because the appearance of a point changes with the distance. A match that would
join two keypoints of one image is dropped, and counted. Other wrong matches remain in the tracks, for the robust
estimation to find.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from slam_init.calibration.values import at_place
from slam_init.datasets import image_files
from slam_init.datasets.text import image_times, pose_from_matrix, trajectory
from slam_init.errors import SourceError
from slam_init.system.numpy_file import parse_npz
from slam_init.system.regular_file import open_regular
from slam_init.types.arrays import Floats, Image, Ints, as_array
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.pose import Trajectory

# -- matches chained to tracks ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PairMatches:
    """The matches of two images."""

    #: first, second: Indices of the images.
    first: int
    second: int
    #: (M, 2) Indices of a keypoint of the first image and of one of the second.
    keypoints: Ints


@dataclass(frozen=True, eq=False)
class TrackTable:
    """Tracks as a table of observations, sorted by frame, and in a frame by track."""

    #: (M,) Index of the image of each observation.
    frames: Ints
    #: (M,) A track is in a frame at most once.
    track_ids: Ints
    #: (M, 2) Pixel centres at integer coordinates.
    pixels: Floats

    @staticmethod
    def of(frames: Ints, track_ids: Ints, pixels: Floats) -> TrackTable:
        """Sort observations.

        Shapes: ``frames, track_ids`` (M,), ``pixels`` (M, 2).
        """
        order = np.lexsort((track_ids, frames))
        return TrackTable(frames[order], track_ids[order], pixels[order])

    def seen(self, rows: Ints | slice, camera: Camera) -> tuple[Ints, Floats, Floats]:
        """Give the tracks, pixels and bearings of rows, without those that the camera cannot have seen.

        Shapes: returns (N,), returns (N, 2), returns (N, 3).
        """
        bearings = camera.bearings(self.pixels[rows])
        seen = np.isfinite(bearings).all(axis=1)
        return self.track_ids[rows][seen], self.pixels[rows][seen], bearings[seen]


def chain_matches(
    keypoints: Sequence[Floats], pairs: Iterable[PairMatches], what: str
) -> tuple[TrackTable, tuple[str, ...]]:
    """Chain matches to tracks.

    Shapes: ``keypoints`` (N, 2).

    * ``keypoints``: The keypoints of each image. Keypoints at one place (of several scales or orientations) count as
      one.
    * Returns ``table``: The tracks that are seen in two images at least, numbered by their first observation.
    * Returns ``notes``: How many matches were dropped because they join two keypoints of one image.
    """
    nodes, images, pixels = _nodes(keypoints)
    edges = _edges(nodes, pairs, what)
    labels, dropped = _labels(edges, images)
    counts = np.bincount(labels, minlength=len(pixels))
    seen = np.flatnonzero(counts[labels] >= 2)
    _, first, inverse = np.unique(labels[seen], return_index=True, return_inverse=True)
    # Nodes are sorted by image, so that this is the order of the first observations.
    track_ids = np.argsort(np.argsort(first, kind="stable"), kind="stable")[inverse]
    notes = (f"{dropped} matches would join two points of one image in a track, and are dropped",) if dropped else ()
    return TrackTable.of(images[seen], track_ids.astype(np.int64), pixels[seen]), notes


def _nodes(keypoints: Sequence[Floats]) -> tuple[list[Ints], Ints, Floats]:
    """For each keypoint the number of its node; for each node its image and place. Nodes are sorted by image."""
    sizes = [len(points) for points in keypoints]
    images, places = np.repeat(np.arange(len(sizes)), sizes), np.concatenate([np.zeros((0, 2)), *keypoints])
    _, first, inverse = np.unique(np.column_stack([images, places]), axis=0, return_index=True, return_inverse=True)
    # Numbered as the keypoints are, and not by place.
    nodes = np.argsort(np.argsort(first))[inverse.reshape(-1)]
    order = np.sort(first)
    return np.split(nodes, np.cumsum(sizes)[:-1]), images[order], places[order]


def _edges(nodes: Sequence[Ints], pairs: Iterable[PairMatches], what: str) -> Ints:
    """The matched nodes (M, 2), in the order of the distance of their images; each pair of nodes once."""
    found: list[Ints] = []
    gaps: list[Ints] = []
    for pair in pairs:
        matched = pair.keypoints
        for image, column in ((pair.first, matched[:, 0]), (pair.second, matched[:, 1])):
            if len(column) and not (column.min() >= 0 and column.max() < len(nodes[image])):
                pair_of = f"a match of {pair.first} and {pair.second}"
                raise SourceError(f"{what}: {pair_of} names a keypoint that {image} lacks")
        ends = np.column_stack([nodes[pair.first][matched[:, 0]], nodes[pair.second][matched[:, 1]]])
        found.append(np.sort(ends, axis=1))
        gaps.append(np.full(len(ends), abs(pair.first - pair.second)))
    if not found:
        return np.zeros((0, 2), np.int64)
    edges, first = np.unique(np.concatenate(found), axis=0, return_index=True)
    order = np.argsort(np.concatenate(gaps)[first], kind="stable")
    return np.asarray(edges[order], np.int64)


def _labels(edges: Ints, images: Ints) -> tuple[Ints, int]:
    """The number of the track of each node, and how many matches were dropped."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(images)
    if count == 0:
        return np.zeros(0, np.int64), 0
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, connected = connected_components(graph, directed=False)
    labels = np.asarray(connected, np.int64)
    order = np.lexsort((images, labels))
    twice = (np.diff(labels[order]) == 0) & (np.diff(images[order]) == 0)
    in_conflict = np.isin(labels, labels[order[1:][twice]])
    sets, dropped = _chained(np.flatnonzero(in_conflict), edges[in_conflict[edges[:, 0]]], images)
    # The numbers of nodes name the sets that were chained again; they follow the numbers of the others.
    labels[in_conflict] = count + sets
    _, numbered = np.unique(labels, return_inverse=True)
    return np.asarray(numbered, np.int64), dropped


def _chained(nodes: Ints, edges: Ints, images: Ints) -> tuple[Ints, int]:
    """Sets of nodes with at most one node of each image, chained edge by edge; and how many edges were dropped.

    Shapes: ``nodes`` (N,), ``edges`` (M, 2), returns (N,): a node that names the set.
    """
    from scipy.cluster.hierarchy import DisjointSet

    sets, dropped = DisjointSet(nodes.tolist()), 0
    images_of = {node: {int(images[node])} for node in nodes.tolist()}
    for a, b in edges.tolist():
        root, other = sets[a], sets[b]
        if root == other:
            continue
        if images_of[root].isdisjoint(images_of[other]):
            sets.merge(root, other)
            images_of[sets[root]] = images_of[root] | images_of[other]
        else:
            dropped += 1
    return np.array([sets[node] for node in nodes.tolist()], np.int64), dropped


_BACKGROUND, _DOT = 30, 220


@runtime_checkable
class TrackProvider(Protocol):
    """A source that knows the tracks of its frames, so that no tracker is needed."""

    def observed(self, frame: Frame, camera: Camera) -> Observations:
        """Give the tracks of a frame."""
        ...


def _draw_points(size: tuple[int, int], pixels: Floats) -> Image:
    """Draw points as an image, for sources that have none.

    Shapes: ``pixels`` (N, 2), returns (H, W).
    """
    width, height = size
    image = np.full((height, width), _BACKGROUND, np.uint8)
    column, row = np.round(pixels).astype(int).T
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        image[np.clip(row + dy, 0, height - 1), np.clip(column + dx, 0, width - 1)] = _DOT
    return image


@dataclass(frozen=True, eq=False)
class TrackSource:
    """A :class:`slam_init.types.frame.TimedSource` of given tracks; its images are dots, or pictures."""

    #: name, kind, camera, groundtruth: See :class:`slam_init.types.frame.Source`.
    name: str
    kind: str
    #: One for each frame.
    image_names: tuple[str, ...]
    #: (F,) Strictly increasing.
    timestamps_s: Floats
    #: (int, int) Width and height of the images in pixels.
    size: tuple[int, int]
    table: TrackTable
    camera: Camera | None = None
    groundtruth: Trajectory | None = None
    #: What the user should know about the source.
    notes: tuple[str, ...] = ()
    #: The images.
    pictures: image_files.ImageFileSource | None = None
    #: For each frame the index of its image in ``pictures``.
    picture_indices: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.image_names)

    def _rows(self, index: int) -> slice:
        """The rows of a frame in the table."""
        return slice(*np.searchsorted(self.table.frames, [index, index + 1]).tolist())

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read the pictures, or draw the points."""
        for index in image_files.frame_range(len(self), start, max_frames, self.name):
            name = self.image_names[index]
            if self.pictures is None:
                image = _draw_points(self.size, self.table.pixels[self._rows(index)])
            else:
                image = next(self.pictures.frames(self.picture_indices[index], 1)).image
                image_files.check_size(name, (image.shape[1], image.shape[0]), self.size, f"that of {self.name}")
            yield Frame(index, float(self.timestamps_s[index]), name, image)

    def observed(self, frame: Frame, camera: Camera) -> Observations:
        """Give the tracks of a frame, without those that the camera cannot have seen."""
        from slam_init.frontend.tracks import colors_at

        ids, pixels, bearings = self.table.seen(self._rows(frame.index), camera)
        colors = colors_at(frame.image, pixels)
        return Observations(frame.index, frame.timestamp_s, frame.name, ids, pixels, bearings, colors)

    def observations(self, start: int = 0) -> Iterator[Observations]:
        """Give the tracks of each frame in order, with the calibration of the source."""
        if self.camera is None:
            raise SourceError(f"{self.name} has no calibration")
        for frame in self.frames(start):
            yield self.observed(frame, self.camera)


def track_source(
    path: Path,
    kind: str,
    image_names: tuple[str, ...],
    size: tuple[int, int],
    table: TrackTable,
    *,
    camera: Camera | None = None,
    timestamps_s: Floats | None = None,
    notes: tuple[str, ...] = (),
) -> TrackSource:
    """Make a source of tracks; check what the formats have in common.

    Shapes: ``timestamps_s`` (F,).
    """
    image_files.check_pixels(str(path), *size)
    # Keypoints of the last row lie up to half a pixel beyond its centre; some detectors refine them beyond that.
    inside = ((table.pixels >= -1.0) & (table.pixels <= np.array(size))).all(axis=1)
    if not inside.all():
        notes = (*notes, f"{int((~inside).sum())} observations outside of the images are left out")
        table = TrackTable(table.frames[inside], table.track_ids[inside], table.pixels[inside])
    if len(table.frames) == 0:
        raise SourceError(f"{path}: holds no track: no point is matched in two images")
    times_s = np.arange(len(image_names)) / image_files.PHOTO_RATE_HZ if timestamps_s is None else timestamps_s
    return TrackSource(path.name, kind, image_names, times_s, size, table, camera, notes=notes)


def by_name(path: Path, names: list[str]) -> list[int]:
    """Order images by their names."""
    for name, count in Counter(names).items():
        if count > 1:
            raise SourceError(f"{path}: the image {name[:100]} is there {count} times")
    return sorted(range(len(names)), key=lambda i: image_files.natural_key(names[i]))


def with_pictures(source: TrackSource, pictures: image_files.ImageFileSource) -> TrackSource:
    """Add the images to a source of tracks, and what their data set knows: order, times, calibration and truth.

    * ``pictures``: Its images are found by the longest common end of their paths.
    * Returns: The frames are in the order of ``pictures``. The calibration is that of the source, if it has one.
    """
    indices = []
    found = image_files.find_by_end(source.image_names, [path.as_posix() for path in pictures.paths])
    for name, candidates in zip(source.image_names, found, strict=True):
        if len(candidates) != 1:
            problem = f"{len(candidates)} pictures" if candidates else "no picture"
            raise SourceError(f"{pictures.name}: {problem} of {name[:100]}: give the image folder of {source.name}")
        indices += candidates
    if len(set(indices)) < len(indices):
        raise SourceError(f"{pictures.name}: one picture for two images of {source.name}: give its image folder")
    order, table = np.argsort(indices, kind="stable"), source.table
    sorted_indices = tuple(sorted(indices))
    return replace(
        source,
        image_names=tuple(source.image_names[i] for i in order.tolist()),
        timestamps_s=pictures.timestamps_s[list(sorted_indices)],
        table=TrackTable.of(np.argsort(order)[table.frames], table.track_ids, table.pixels),
        camera=source.camera or pictures.camera,
        groundtruth=pictures.groundtruth or source.groundtruth,
        notes=(*source.notes, *pictures.notes),
        pictures=pictures,
        picture_indices=sorted_indices,
    )


# -- a file of tracks ------------------------------------------------------------------------------


_REQUIRED = ("frame", "track", "xy", "size")
_OPTIONAL = ("names", "timestamps_s", "K", "distortion", "model", "world_from_cam")
# Twenty million observations have 32 bytes each.
_MAX_BYTES = 640_000_000
# Most frames without names: nine hours at 30 Hz.
_MAX_UNNAMED = 1_000_000


def read_npz(
    path: Path, required: Collection[str], limit_bytes: int, what: str, optional: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """Read named arrays from a ``.npz`` file; see :func:`slam_init.system.numpy_file.parse_npz`.

    * ``required, optional``: Names of the arrays.
    """
    with open_regular(path, SourceError) as file:
        arrays = parse_npz(str(path), file, (*required, *optional), limit_bytes, what)
    if missing := [name for name in required if name not in arrays]:
        raise SourceError(f"{path}: has no array {missing[0]}: expected {what}")
    return arrays


def open_tracks_file(path: Path) -> TrackSource:
    """Open a file of tracks."""
    arrays = read_npz(path, _REQUIRED, _MAX_BYTES, "tracks", _OPTIONAL)

    def array(name: str, kind: type, *shape: int | None) -> NDArray[Any]:
        return as_array(arrays[name], kind, shape, f"{path}: {name}", error=SourceError)

    frame, track, xy = array("frame", np.int64, None), array("track", np.int64, None), array("xy", np.float64, None, 2)
    width, height = array("size", np.int64, 2).tolist()
    if not len(frame) == len(track) == len(xy):
        raise SourceError(f"{path}: frame, track and xy have {len(frame)}, {len(track)} and {len(xy)} rows")
    names = _names(path, arrays.get("names"), int(frame.max(initial=-1)) + 1)
    if len(frame) and (frame.min() < 0 or frame.max() >= len(names)):
        raise SourceError(f"{path}: frame has the value {frame.max()}, but there are {len(names)} names")
    table = TrackTable.of(frame, track, xy)
    if ((np.diff(table.frames) == 0) & (np.diff(table.track_ids) == 0)).any():
        raise SourceError(f"{path}: a track is in a frame twice: give each track once in a frame")
    timestamps_s: Floats | None = None
    notes: tuple[str, ...] = ()
    if "timestamps_s" in arrays:
        stamps = array("timestamps_s", np.float64, len(names))
        timestamps_s, notes = image_times(stamps.tolist(), [f"{path}: timestamps_s[{i}]" for i in range(len(stamps))])
    camera: Camera | None = None
    if "K" in arrays:
        K = array("K", np.float64, 3, 3)
        distortion = array("distortion", np.float64, None).tolist() if "distortion" in arrays else []
        model = str(arrays.get("model", "radtan" if distortion else "pinhole"))
        with at_place(f"{path}: K"):
            camera = Camera(model, width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(distortion))
    source = track_source(
        path, "tracks", names, (width, height), table, camera=camera, timestamps_s=timestamps_s, notes=notes
    )
    if "world_from_cam" not in arrays:
        return source
    matrices = arrays["world_from_cam"]
    if matrices.shape != (len(source), 4, 4) or matrices.dtype.kind != "f":
        found = f"{matrices.dtype} of shape {matrices.shape}"
        raise SourceError(f"{path}: world_from_cam is {found}: expected numbers ({len(source)}, 4, 4)")
    stamped = [
        (float(source.timestamps_s[i]), pose_from_matrix(f"{path}: world_from_cam[{i}]", matrix))
        for i, matrix in enumerate(matrices.astype(float))
        if np.isfinite(matrix).all()  # NaN: unknown
    ]
    return replace(source, groundtruth=trajectory(stamped))


def _names(path: Path, stated: NDArray[Any] | None, count: int) -> tuple[str, ...]:
    if stated is None:
        if count > _MAX_UNNAMED:
            raise SourceError(f"{path}: frame has the value {count - 1}: expected less than {_MAX_UNNAMED}")
        return tuple(f"frame-{i:06d}" for i in range(count))
    names = [str(name) for name in stated.ravel()]
    by_name(path, names)  # checks them; the order is that of the file
    return tuple(names)
