"""The views that a motion does not know yet, located by the points of those that it knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quest.algebra import median_in_place
from quest.robust.kernels.refinement import refine_rotation
from slam_init.mapping.resection import resect, triangulate
from slam_init.types.arrays import Bools, Floats
from slam_init.types.pose import Pose
from slam_init.window.compiler import compiled, part
from slam_init.window.motion import Motion
from slam_init.window.tracks import WindowTracks

#: A further view needs this many points of the motion: twice the six unknowns of its pose in coordinates, and as many
#: again to contradict the motion.
#: Class: geometry.
MIN_RESECTED = 12
#: Outlier threshold of a further view before the joint fit, in standard deviations of the noise.
#: Class: level.
_RESECTION_SIGMAS = 4.0
#: Scales of the robust kernel that aligns two views by a rotation. The first one reaches 25 degrees, the angle between
#: two photos of a panorama; the last one is a few pixels. At each scale so many steps are taken.
_SCALES_RAD, _STEPS = (0.4, 0.1, 0.03, 0.01), 4


def align_views(bearings: Floats, motions: Sequence[Motion], pair: tuple[int, ...]) -> Floats:
    """Align the first view with each view by a rotation.

    Shapes: ``bearings`` (V, T, 3), returns (V, 3, 3).

    * ``motions``: The rotation of the first one is a start for the second view.
    """
    R = np.tile(np.eye(3), (len(bearings), 1, 1))
    for motion in motions[:1]:
        known = motion.cam_from_world
        if pair[0] in known and pair[1] in known:
            R[1] = known[pair[1]].R @ known[pair[0]].R.T
    align_with_first(bearings, R)
    return R


def locate_views(
    tracks: WindowTracks, motion: Motion, bearings: Floats, rotations: Floats, *, current: bool = True
) -> Motion | None:
    """Extend a motion to all views that its points locate; the reference becomes the world.

    Shapes: ``bearings`` (V, T, 3), ``rotations`` (V, 3, 3).

    * ``current``: Whether the current view has to be among them, and not any view beside the reference.
    * Returns: None where reference or current is not among the views that it knows then.
    """
    known = _resected(tracks, motion, bearings, rotations)
    if 0 not in known or len(known) < 2 or (current and 1 not in known):
        return None
    to_reference = known[0].inverse()
    plane = None if motion.plane is None else _moved_plane(motion.plane, known[0])
    return replace(
        motion,
        cam_from_world={tracks.frames[row]: known[row] @ to_reference for row in sorted(known)},
        plane=plane,
        points=None if motion.points is None else motion.points.moved(to_reference.inverse()),
    )


def _resected(tracks: WindowTracks, motion: Motion, bearings: Floats, rotations: Floats) -> dict[int, Pose]:
    """The poses of the views that a motion knows or that its points locate, by row."""
    known = motion.known_in(tracks)
    if len(known) < 2 or len(known) == len(tracks.frames):
        return known
    threshold_rad = _RESECTION_SIGMAS * tracks.noise_px / tracks.camera.focal_px
    rows = list(known)
    usable: Bools
    if motion.points is None:
        points = triangulate([pose.inverse() for pose in known.values()], bearings[rows])
        usable = _explained(points, list(known.values()), bearings[rows], threshold_rad)
    else:
        points = motion.points.of_tracks(tracks.track_ids)
        usable = np.asarray(np.isfinite(points).all(axis=1))
        # Its points are seen through its lens.
        bearings = tracks.bearings(motion.lens)
    for row in range(len(bearings)):
        visible = usable & np.isfinite(bearings[row, :, 0])
        if row in known or visible.sum() < MIN_RESECTED:
            continue
        nearest = min(rows, key=lambda one: abs(tracks.frames[one] - tracks.frames[row]))
        turned = Pose(rotations[row] @ rotations[nearest].T, np.zeros(3)) @ known[nearest]
        resected = resect(points[visible], bearings[row, visible], threshold_rad, turned)
        if resected is not None and resected[1].sum() >= MIN_RESECTED:
            known[row] = resected[0]
    return known


def _explained(points: Floats, poses: list[Pose], bearings: Floats, threshold_rad: float) -> Bools:
    """The points that lie in front of the known cameras and project to their tracks in at least two of them."""
    finite, seen = np.isfinite(points).all(axis=1), np.isfinite(bearings[..., 0])
    local = np.array([pose.apply(np.nan_to_num(points)) for pose in poses])
    local /= np.maximum(np.linalg.norm(local, axis=2, keepdims=True), 1e-300)
    near = np.linalg.norm(local - np.nan_to_num(bearings), axis=2) < threshold_rad
    agreeing, against = (seen & near).sum(axis=0), (seen & ~near).sum(axis=0)
    return np.asarray(finite & (agreeing >= 2) & (against <= agreeing // 2))


def _moved_plane(plane: Floats, new_from_old: Pose) -> Floats:
    """A plane ``k . X = 1`` in another frame of reference."""
    turned = new_from_old.R @ plane
    return np.asarray(turned / (1 + float(turned @ new_from_old.t)))


# -- alignment of the views by rotations -------------------------------------------------------------------------------


@compiled
def align_with_first(bearings: Floats, R: Floats) -> None:
    """Align the first view with each view by a rotation, from no rotation and from a proposed one.

    Shapes: ``bearings`` (V, T, 3), ``R`` (V, 3, 3).

    * ``bearings``: NaN where a view does not see a track.
    * ``R``: The second one is the proposal for its view. Receives the rotations: the proposal for a further view is
      that of the second one, and a view with fewer than three common tracks has none.
    """
    V, T = bearings.shape[:2]
    m, n, left, tried = np.empty((T, 3)), np.empty((T, 3)), np.empty(T), np.empty((3, 3))
    none, proposal = np.eye(3), R[1].copy()
    _copy(none, R[0])
    for k in range(1, V):
        count = 0
        for i in range(T):
            if np.isfinite(bearings[0, i, 0]) and np.isfinite(bearings[k, i, 0]):
                for q in range(3):
                    m[count, q], n[count, q] = bearings[0, i, q], bearings[k, i, q]
                count += 1
        _copy(none, R[k])
        least = np.inf
        for start in range(2 if count >= 3 else 0):
            _copy(proposal if start == 1 else none, tried)
            for scale_rad in _SCALES_RAD:
                refine_rotation(m[:count], n[:count], tried, scale_rad, int(_STEPS))  # not the constant: compiled once
            for i in range(count):
                square = 0.0
                for q in range(3):
                    turned = tried[q, 0] * m[i, 0] + tried[q, 1] * m[i, 1] + tried[q, 2] * m[i, 2]
                    aside = n[i, q] - turned
                    square += aside * aside
                left[i] = np.sqrt(square)
            median = median_in_place(left[:count])
            if median < least:
                least = median
                _copy(tried, R[k])
        if k == 1:
            _copy(R[1], proposal)


@part
def _copy(R: Floats, to: Floats) -> None:
    for p in range(3):
        for q in range(3):
            to[p, q] = R[p, q]
