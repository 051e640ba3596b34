"""The size of a planar target in units of the map, from its pixels in keyframes of known poses.

The target is a rigid set of points ``X = c + a R m`` with the points m in metres. Its pose (R, c) and its size a, the
units of the map in a metre, are fitted to all pixels by least squares. Start: a view tells R and the direction of c
from the homography of the target (IPPE [1]_), and a is then a linear unknown of the other views.

References
----------
.. [1] T. Collins, A. Bartoli, Infinitesimal plane-based pose estimation, IJCV 2014 (OpenCV, ``SOLVEPNP_IPPE``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.scale.sensitivity import by_pose, projection_derivatives, skew
from slam_init.scale.sightings import Sighting
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose

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
class _View:
    """A sighting from a keyframe."""

    position: int
    world_from_cam: Pose
    sighting: Sighting
    rays: Floats


@dataclass(frozen=True, eq=False)
class _Target:
    """Pose and size of a target: ``X = centre + exp(log_units) R m``."""

    R: Floats
    centre: Floats
    log_units: float

    def points(self, points_m: Floats) -> Floats:
        return np.asarray(self.centre + np.exp(self.log_units) * points_m @ self.R.T)


def fit_target(map_: InitialMap, sightings: Sequence[Sighting]) -> TargetSize | None:
    """Fit the pose and the size of a target.

    * ``sightings``: Of one target. Those of frames that are no keyframes are ignored.
    * Returns: None if fewer than two views fit together: the target moves, or the camera does not.
    """
    views = _views(map_, sightings)
    while len(views) >= 2:
        found = _fitted(map_, views)
        if found is None:
            return None
        target, errors_px = found
        if max(errors_px) <= _WORST_PX:
            return _size(map_, views, target)
        del views[int(np.argmax(errors_px))]
    return None


def _views(map_: InitialMap, sightings: Sequence[Sighting]) -> list[_View]:
    views = []
    positions = {keyframe.frame: k for k, keyframe in enumerate(map_.keyframes)}
    for sighting in sightings:
        if sighting.frame not in positions:
            continue
        k = positions[sighting.frame]
        rays = map_.camera.bearings(sighting.pixels)
        # The homography needs rays on the plane z = 1.
        if np.isfinite(rays).all() and (rays[:, 2] > 0.05).all():
            views.append(_View(k, map_.keyframes[k].world_from_cam, sighting, rays))
    return views


def _fitted(map_: InitialMap, views: Sequence[_View]) -> tuple[_Target, list[float]] | None:
    """The best fit from all starts of the largest view, and the root mean square error of each view."""
    largest = max(views, key=lambda view: float(np.ptp(view.sighting.pixels, axis=0).prod()))
    best: tuple[float, list[_View], _Target] | None = None
    for start in _planar_poses(largest):
        turned = [_same_way(view, largest, start) for view in views]
        units = _units_of_start(largest, start, turned)
        if not units > 0:
            continue
        world = largest.world_from_cam
        target = _refined(map_, turned, _Target(world.R @ start.R, world.apply(units * start.t), float(np.log(units))))
        if target is None:
            continue
        cost = float(sum(np.sum(_residuals(map_, view, target) ** 2) for view in turned))
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = cost, turned, target
    if best is None:
        return None
    _, turned, target = best
    if isinstance(views, list):
        views[:] = turned
    errors = [float(np.sqrt(np.mean(np.sum(_residuals(map_, view, target) ** 2, axis=1)))) for view in turned]
    return target, errors


def _planar_poses(view: _View) -> list[Pose]:
    """Both ``cam_from_target`` of a view, in metres."""
    import cv2

    xy = view.rays[:, :2] / view.rays[:, 2:]
    found, rotations, translations, _ = cv2.solvePnPGeneric(
        view.sighting.points_m, xy, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
    )
    if not found:
        return []
    return [
        Pose(rotation_from_vector(np.ravel(rotation)), np.asarray(translation, float).ravel())
        for rotation, translation in zip(rotations, translations, strict=True)
        if np.isfinite(rotation).all() and np.isfinite(translation).all()
    ]


def _same_way(view: _View, largest: _View, start: Pose) -> _View:
    """The view with its corners in the order that fits the start: half a turn of a board may look the same."""
    if len(view.sighting.points_m) == 4:  # the corners of a marker are distinguished by its pattern
        return view
    world = largest.world_from_cam.R @ start.R
    reversed_ = replace(view, sighting=replace(view.sighting, pixels=view.sighting.pixels[::-1]), rays=view.rays[::-1])
    turned_by = [
        min((rotation_angle(world.T @ one.world_from_cam.R @ pose.R) for pose in _planar_poses(one)), default=np.inf)
        for one in (view, reversed_)
    ]
    return view if turned_by[0] <= turned_by[1] else reversed_


def _units_of_start(largest: _View, start: Pose, views: Sequence[_View]) -> float:
    """Units of the map in a metre, by linear least squares on the other views: ``n x (e + a f) = 0``."""
    total = gain = 0.0
    for view in views:
        if view.position == largest.position:
            continue
        other = view.world_from_cam.inverse() @ largest.world_from_cam
        f = start.apply(view.sighting.points_m) @ other.R.T
        across, offset = np.cross(view.rays, f), np.cross(view.rays, other.t)
        total -= float(np.sum(across * offset))
        gain += float(np.sum(across**2))
    return total / gain if gain > 0 else 0.0


def _residuals(map_: InitialMap, view: _View, target: _Target) -> Floats:
    in_camera = view.world_from_cam.inverse().apply(target.points(view.sighting.points_m))
    return np.asarray(map_.camera.project(in_camera) - view.sighting.pixels)


def _jacobians(map_: InitialMap, view: _View, target: _Target) -> tuple[Floats, Floats]:
    """Derivatives of the residuals by the target (2 P, 7) and by the pose of the view (2 P, 6)."""
    cam_from_world = view.world_from_cam.inverse()
    sized = np.exp(target.log_units) * view.sighting.points_m @ target.R.T
    in_camera = cam_from_world.apply(target.centre + sized)
    derivatives = projection_derivatives(map_.camera, in_camera)
    by_target = np.concatenate(
        [-skew(sized), np.broadcast_to(np.eye(3), (len(sized), 3, 3)), sized[:, :, None]], axis=2
    )
    own = derivatives @ cam_from_world.R @ by_target
    return own.reshape(-1, 7), by_pose(derivatives, in_camera).reshape(-1, 6)


def _refined(map_: InitialMap, views: Sequence[_View], target: _Target) -> _Target | None:
    """The target with the least residuals near a start; None where the start leaves the view."""
    from scipy.optimize import least_squares

    def moved(step: Floats) -> _Target:
        R = rotation_from_vector(step[:3]) @ target.R
        return _Target(R, target.centre + step[3:6], target.log_units + float(step[6]))

    def residuals(step: Floats) -> Floats:
        return np.concatenate([_residuals(map_, view, moved(step)).ravel() for view in views])

    start = np.zeros(7)
    if not np.isfinite(residuals(start)).all():
        return None
    return moved(least_squares(residuals, start, x_scale="jac", xtol=_CONVERGED).x)


def _size(map_: InitialMap, views: Sequence[_View], target: _Target) -> TargetSize | None:
    """The size of a fitted target, with its variance and its derivatives by the poses."""
    blocks = [_jacobians(map_, view, target) for view in views]
    J = np.concatenate([own for own, _ in blocks])
    r = np.concatenate([_residuals(map_, view, target).ravel() for view in views])
    H = J.T @ J
    if np.linalg.matrix_rank(H) < 7:
        return None
    inverse = np.linalg.inv(H)
    noise_px = max(_LEAST_NOISE_PX, float(np.sqrt(np.sum(r**2) / max(len(r) - 7, 1))))
    by_poses = np.zeros(6 * len(map_.keyframes))
    for view, (own, pose) in zip(views, blocks, strict=True):
        by_poses[6 * view.position : 6 * view.position + 6] -= inverse[6] @ own.T @ pose
    return TargetSize(
        target=views[0].sighting.target,
        log_units=target.log_units,
        variance=noise_px**2 * float(inverse[6, 6]),
        by_poses=by_poses,
        frames=tuple(view.sighting.frame for view in views),
    )
