"""Chains the matches of image pairs to tracks.

A track is a connected set of keypoints. Two keypoints of one image cannot see one point, so a set with two of them
holds a wrong match. Such sets are chained again, one match after the other: matches of near images first, because the
appearance of a point changes with the distance. A match that would join two keypoints of one image is dropped, and
counted. Other wrong matches remain in the tracks, for the robust estimation to find.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.errors import SourceError
from slam_init.types.arrays import Floats, Ints


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
