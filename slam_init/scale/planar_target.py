"""Markers and checkerboards: finds them in images, and their size in units of the map.

The target is a rigid set of points ``X = c + a R m`` with the points m in metres. Its pose (R, c) and its size a, the
units of the map in a metre, are fitted to all pixels by least squares. Start: a view gives R and the direction of c
from the homography of the target (IPPE [1]_), and a is the path of the camera in the map over that by the homographies.

References
----------
.. [1] T. Collins, A. Bartoli, Infinitesimal plane-based pose estimation, IJCV 2014 (OpenCV, ``SOLVEPNP_IPPE``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.scale.requests import KnownBoard, KnownMarkers, marker_dictionary
from slam_init.scale.sensitivity import by_pose, projection_derivatives
from slam_init.types.arrays import Floats, Image
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose

#: Corners of a marker of side 2 as OpenCV lists them: from the upper left one, clockwise.
_CORNERS = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Sighting:
    """A target of known size in one image."""

    #: Absolute index of the frame.
    frame: int
    #: Number of the marker; 0 for the board.
    target: int
    #: (P, 3) Points of the target in its own frame, in metres; z = 0.
    points_m: Floats
    #: (P, 2) Their raw pixels.
    pixels: Floats


def find_markers(images: Mapping[int, Image], markers: KnownMarkers) -> list[Sighting]:
    """Find all markers of a dictionary in images.

    Shapes: ``images`` (H, W).

    * Returns: A number that an image shows twice is left out of this image: a marker on a poster, or a copy.
    """
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(marker_dictionary(markers.dictionary), parameters)
    points_m = 0.5 * markers.length.metres * _CORNERS
    sightings = []
    for frame, image in sorted(images.items()):
        corners, numbers, _ = detector.detectMarkers(image)
        found = [] if numbers is None else [int(number) for number in np.ravel(numbers)]
        for number, pixels in zip(found, corners, strict=True):
            if found.count(number) == 1:
                sightings.append(Sighting(frame, number, points_m, np.asarray(pixels, float).reshape(4, 2)))
    return sightings


def find_board(images: Mapping[int, Image], board: KnownBoard) -> list[Sighting]:
    """Find a checkerboard in images.

    Shapes: ``images`` (H, W).

    * Returns: At most one for each image. Half a turn of a board may look the same, so the order of the corners may be
      reversed from one image to another.
    """
    import cv2

    x, y = np.meshgrid(np.arange(float(board.columns)), np.arange(float(board.rows)))
    points_m = board.length.metres * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points_m = np.asarray(points_m - points_m.mean(axis=0), float)
    sightings = []
    for frame, image in sorted(images.items()):
        found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=cv2.CALIB_CB_ACCURACY)
        if found:
            sightings.append(Sighting(frame, 0, points_m, np.asarray(corners, float).reshape(-1, 2)))
    return sightings


#: Least standard deviation of a corner: blur and the print move all corners of a target alike, which the residuals do
#: not show.
_LEAST_NOISE_PX = 0.1
#: A view whose corners miss by more is that of another target, or of one that moved: a track that misses by as much is
#: not located either.
_WORST_PX = 3.0
#: The fit has converged where a step changes pose and size by less than a billionth.
_CONVERGED = 1e-9


@dataclass(frozen=True, eq=False)
class TargetSize:
    """The size of a target."""

    #: Number of the target.
    target: int
    #: Logarithm of the units of the map in a metre.
    log_units: float
    #: Its variance for given poses, by the noise of the corners.
    variance: float
    #: Its derivatives by the poses of the keyframes.
    by_poses: Floats
    #: Frames of the views.
    frames: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _View(Sighting):
    """A sighting from a keyframe, which has a position in the map."""

    position: int
    world_from_cam: Pose
    rays: Floats


class _Fit(NamedTuple):
    """A fitted target: the views with their corners in its order, and its size, which may be undetermined."""

    views: list[_View]
    #: (V, P, 2)
    residuals_px: Floats
    size: TargetSize | None


def fit_target(map_: InitialMap, sightings: Sequence[Sighting]) -> TargetSize | None:
    """Fit the pose and the size of a target.

    * ``sightings``: Of one target. Those of frames that are no keyframes are ignored.
    * Returns: None if fewer than two views fit together: the target moves, or the camera does not.
    """
    views = _views(map_, sightings)
    while len(views) >= 2:
        largest = max(views, key=lambda view: float(np.ptp(view.pixels, axis=0).prod()))
        fits = [_fitted(map_, views, largest, start) for start in _planar_poses(largest)]
        best = min((fit for fit in fits if fit), key=lambda fit: float(np.sum(fit.residuals_px**2)), default=None)
        if best is None:
            return None
        errors_px = np.sqrt(np.mean(np.sum(best.residuals_px**2, axis=2), axis=1))
        if errors_px.max() <= _WORST_PX:
            return best.size
        views = best.views
        del views[int(np.argmax(errors_px))]
    return None


def _views(map_: InitialMap, sightings: Sequence[Sighting]) -> list[_View]:
    positions = {keyframe.frame: k for k, keyframe in enumerate(map_.keyframes)}
    known = [(one, positions[one.frame]) for one in sightings if one.frame in positions]
    seen = [(one, k, map_.camera.bearings(one.pixels)) for one, k in known]
    views = [
        _View(**vars(one), position=k, world_from_cam=map_.keyframes[k].world_from_cam, rays=rays)
        for one, k, rays in seen
        if np.isfinite(rays).all() and (rays[:, 2] > 0.05).all()  # the homography needs rays on the plane z = 1
    ]
    return [view for view in views if _planar_poses(view)]


def _planar_poses(view: _View) -> list[Pose]:
    """Both ``cam_from_target`` of a view, in metres."""
    import cv2

    xy = view.rays[:, :2] / view.rays[:, 2:]
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        view.points_m, xy, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
    )
    return [
        Pose(rotation_from_vector(np.ravel(rotation)), np.asarray(translation, float).ravel())
        for rotation, translation in zip(rotations, translations, strict=True)
        if np.isfinite(rotation).all() and np.isfinite(translation).all()
    ]


def _fitted(map_: InitialMap, views: Sequence[_View], largest: _View, start: Pose) -> _Fit | None:
    """The best fit near the pose ``cam_from_target`` of the largest view; None where the start leaves a view."""
    from scipy.optimize import least_squares

    views = [_same_way(view, largest, start) for view in views]
    units = _units_of_start(views)
    if not units > 0:
        return None
    R, centre = largest.world_from_cam.R @ start.R, largest.world_from_cam.apply(units * start.t)

    def in_cameras(x: Floats) -> list[Floats]:
        turned, size = rotation_from_vector(x[:3]) @ R, np.exp(np.log(units) + x[6])
        world = (centre + x[3:6] + size * view.points_m @ turned.T for view in views)
        return [view.world_from_cam.inverse().apply(points) for view, points in zip(views, world, strict=True)]

    def residuals(x: Floats) -> Floats:
        seen = [map_.camera.project(points) for points in in_cameras(x)]
        return np.concatenate([np.ravel(px - view.pixels) for px, view in zip(seen, views, strict=True)])

    if not np.isfinite(residuals(np.zeros(7))).all():
        return None
    found = least_squares(residuals, np.zeros(7), x_scale="jac", xtol=_CONVERGED)
    residuals_px, J = found.fun.reshape(len(views), -1, 2), np.asarray(found.jac)
    H = J.T @ J
    if np.linalg.matrix_rank(H) < 7:
        return _Fit(views, residuals_px, None)
    inverse, excess = np.linalg.inv(H), max(residuals_px.size - 7, 1)
    noise_px = max(_LEAST_NOISE_PX, float(np.sqrt(np.sum(residuals_px**2) / excess)))
    by_poses = np.zeros(6 * len(map_.keyframes))
    for view, points, own in zip(views, in_cameras(found.x), np.split(J, len(views)), strict=True):
        pose = by_pose(projection_derivatives(map_.camera, points), points).reshape(-1, 6)
        by_poses[6 * view.position : 6 * view.position + 6] -= inverse[6] @ own.T @ pose
    size = TargetSize(
        target=largest.target,
        log_units=float(np.log(units) + found.x[6]),
        variance=noise_px**2 * float(inverse[6, 6]),
        by_poses=by_poses,
        frames=tuple(view.frame for view in views),
    )
    return _Fit(views, residuals_px, size)


def _same_way(view: _View, largest: _View, start: Pose) -> _View:
    """The view with its corners in the order that fits the start: half a turn of a board may look the same."""
    if len(view.points_m) == 4:  # the corners of a marker are distinguished by its pattern
        return view
    world = largest.world_from_cam.R @ start.R
    reversed_ = replace(view, pixels=view.pixels[::-1], rays=view.rays[::-1])

    def turned_by(one: _View) -> float:
        poses = _planar_poses(one)
        return min(float(rotation_angle(world.T @ one.world_from_cam.R @ pose.R)) for pose in poses)

    return min((view, reversed_), key=turned_by)


def _units_of_start(views: Sequence[_View]) -> float:
    """Units of the map in a metre, by the paths of the camera in the map and by the homographies."""
    path = np.array([view.world_from_cam.t for view in views])
    to_target_m = np.array([view.world_from_cam.R @ _planar_poses(view)[0].t for view in views])
    path, to_target_m = path - path.mean(axis=0), to_target_m - to_target_m.mean(axis=0)
    metres = -float(np.sum(path * to_target_m))
    return float(np.sum(path**2)) / metres if metres > 0 else 0.0
