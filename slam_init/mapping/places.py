"""The place that a map shows: SIFT points of some of its views, triangulated with the poses of the map.

The landmarks of a map are corners, which flow follows but no descriptor finds from far. So SIFT keypoints of the views
are matched among all pairs of views, the epipolar lines of the map test the matches, and what several views see is
triangulated. A keypoint belongs to one point. A point has one keypoint in a view.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slam_init.frontend.sift import detect_sift, match_descriptors
from slam_init.mapping.triangulation import triangulate
from slam_init.types.arrays import Floats, Image, Ints, evenly_spaced
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.place import Place

#: Keypoints of a view, views of the keyframes and as many of located frames, and views that a view is matched with: 45
#: pairs at most. Class: budget.
KEYPOINTS, _VIEWS, _NEXT = 1500, 6, 5
#: Lowe's ratio, as he measured it (IJCV 2004). Class: measured.
RATIO = 0.8
#: Largest distance of a keypoint from its epipolar line, and from the projection of its point. A keypoint of a coarse
#: level is known to a pixel or two. Class: level.
GATE_PX = 3.0
#: Least angle between two rays of a point: at a noise of .5 px and a focal length of 500 px its depth is known to a
#: third. A join weighs rays, not depths, so that such a point still tells. Class: level.
_PARALLAX_DEG = 0.25


def describe_place(map_: InitialMap, located: Sequence[Keyframe], images: Mapping[int, Image]) -> Place:
    """Make the place of a map.

    Shapes: ``images`` (H, W).

    * ``images``: Grey, by frame. Views without one are left out; of more than six of a kind, six are taken evenly.
    * ``located``: Further frames with known poses.
    """
    seen: list[Keyframe] = []
    for views in (map_.keyframes, located):
        at_hand = [view for view in views if view.frame in images]
        seen += [at_hand[k] for k in evenly_spaced(len(at_hand), _VIEWS)]
    found = [detect_sift(images[view.frame], KEYPOINTS) for view in seen]
    bearings = [map_.camera.bearings(one.pixels) for one in found]
    keep = [np.isfinite(one).all(axis=1) for one in bearings]
    rays = [one[mask] for one, mask in zip(bearings, keep, strict=True)]
    described = [one.descriptors[mask] for one, mask in zip(found, keep, strict=True)]
    place = place_of_features(tuple(seen), rays, described, map_.camera.focal_px)
    return replace(place, unit_error=map_.unit_error, lens=map_.camera.parameters)


def place_of_features(
    views: tuple[Keyframe, ...], rays: Sequence[Floats], described: Sequence[Floats], focal_px: float
) -> Place:
    """Match the features of views with known poses, and triangulate them.

    Shapes: ``rays`` (N, 3), ``described`` (N, 128), for each view.
    """
    gate = GATE_PX / focal_px
    tracks = _tracks(views, rays, described, gate)  # (V, T), the feature or -1
    poses = [view.world_from_cam for view in views]
    seen = tracks >= 0
    bearings = np.full((len(views), tracks.shape[1], 3), np.nan)
    for k, of_view in enumerate(rays):
        bearings[k, seen[k]] = of_view[tracks[k, seen[k]]]
    points = triangulate(poses, bearings) if len(views) else np.zeros((0, 3))
    good = np.isfinite(points).all(axis=1)
    in_world = np.zeros_like(bearings)
    errors = np.zeros(bearings.shape[:2])
    for k, pose in enumerate(poses):
        in_camera = pose.inverse().apply(points)
        in_camera /= np.linalg.norm(in_camera, axis=1, keepdims=True)
        errors[k] = np.where(seen[k], np.linalg.norm(in_camera - bearings[k], axis=1), 0.0)
        in_world[k] = bearings[k] @ pose.R.T
    good &= (errors < gate).all(axis=0)
    cosine = np.einsum("vti,wti->vwt", in_world, in_world)
    widest = np.nanmin(cosine, axis=(0, 1), initial=1.0) if len(views) else np.zeros(0)
    good &= widest < math.cos(math.radians(_PARALLAX_DEG))
    view, point = np.nonzero(seen[:, good])
    mean = np.zeros((int(good.sum()), 128))
    for k, of_view in enumerate(described):
        rows = tracks[k, good]
        mean[rows >= 0] += of_view[rows[rows >= 0]]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    # Each point takes three of the two numbers that each of its rays gives.
    freedom = 2 * len(point) - 3 * len(mean)
    noise = math.sqrt(float(np.sum(errors[:, good] ** 2)) / freedom) if freedom > 0 else gate
    return Place(views, points[good], mean, view, point, bearings[:, good][view, point], max(noise, 0.1 / focal_px))


def _tracks(views: Sequence[Keyframe], rays: Sequence[Floats], described: Sequence[Floats], gate: float) -> Ints:
    """Chains of matched features (V, T): the position of the feature in each view, -1 where there is none."""
    starts = np.cumsum([0, *(len(one) for one in rays)])
    links = []
    for a, b in itertools.combinations(range(len(views)), 2):
        if b - a > _NEXT:
            continue
        i, j = match_descriptors(described[a], described[b], RATIO)
        pose = views[b].world_from_cam.inverse() @ views[a].world_from_cam
        if len(i) == 0 or not pose.t.any():
            continue
        normal = np.cross(pose.t, rays[a][i] @ pose.R.T)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        fits = np.abs(np.sum(normal * rays[b][j], axis=1)) < gate
        links.append(np.column_stack([starts[a] + i[fits], starts[b] + j[fits]]))
    edges = np.concatenate([np.zeros((0, 2), np.int64), *links])
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    total = int(starts[-1])
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(total, total))
    label = connected_components(graph, directed=False)[1] if total else np.zeros(0, np.int64)
    of_view = np.repeat(np.arange(len(rays)), np.diff(starts))
    # A chain with two features of one view is no point.
    sizes = np.bincount(label, minlength=1)
    pairs, counts = np.unique(np.column_stack([label, of_view]), axis=0, return_counts=True)
    sound = sizes >= 2
    sound[pairs[counts > 1, 0]] = False
    number = np.where(sound, np.cumsum(sound) - 1, -1)
    tracks = np.full((len(rays), int(sound.sum())), -1, np.int64)
    kept = number[label] >= 0 if total else np.zeros(0, bool)
    tracks[of_view[kept], number[label[kept]]] = (np.arange(total) - starts[of_view])[kept]
    return tracks
