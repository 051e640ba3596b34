"""How the points of a map depend on its poses: derivatives of projections, and of depths along a ray.

A pose ``world_from_cam`` is perturbed as in gtsam: ``pose exp(xi)`` with ``xi = (omega, v)`` in the camera frame. A
point X of the world is then seen at ``X_cam + [X_cam]x omega - v``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap

#: Half of the step of a numerical derivative, over the distance of the point: its error is 1e-8 of the derivative.
_STEP = 1e-4


def projection_derivatives(camera: Camera, in_camera: Floats) -> Floats:
    """Differentiate the projection of points.

    Shapes: ``in_camera`` (N, 3), returns (N, 2, 3).
    """
    step = _STEP * np.linalg.norm(in_camera, axis=1)
    columns = []
    for axis in np.eye(3):
        moved = step[:, None] * axis
        columns.append((camera.project(in_camera + moved) - camera.project(in_camera - moved)) / (2 * step[:, None]))
    return np.stack(columns, axis=-1)


def by_pose(derivatives: Floats, in_camera: Floats) -> Floats:
    """Differentiate the projection of points by the pose of the camera.

    Shapes: ``derivatives`` (N, 2, 3), ``in_camera`` (N, 3), returns (N, 2, 6).
    """
    crossed = np.cross(np.eye(3), in_camera[:, None, :])  # [X]x
    return np.concatenate([derivatives @ crossed, -derivatives], axis=-1)


@dataclass(frozen=True, eq=False)
class InverseDepths:
    """The landmarks as seen by the first camera: inverse depth along a ray. On a plane it is linear in the ray."""

    #: (N, 3) ``(x, y, 1)`` in the frame of the first camera.
    rays: Floats
    #: (N,) Inverse of the depth.
    values: Floats
    #: (N,) Standard deviation for given poses, by the noise of the tracks.
    sigmas: Floats
    #: (N, 6 K) Derivatives by the poses of all keyframes.
    by_poses: Floats


def inverse_depths(map_: InitialMap) -> InverseDepths:
    """Compute the inverse depths of the landmarks in front of the first camera, and what they depend on."""
    first = map_.keyframes[0].world_from_cam
    points = first.inverse().apply(map_.points)
    count, poses = len(points), len(map_.keyframes)
    with np.errstate(divide="ignore", invalid="ignore"):
        rays, values = points / points[:, 2:], 1 / points[:, 2]
    information, cross = np.zeros(count), np.zeros((count, 6 * poses))
    for k, keyframe in enumerate(map_.keyframes):
        seen = map_.observation_landmarks[map_.observation_keyframes == k]
        cam_from_world = keyframe.world_from_cam.inverse()
        in_camera = cam_from_world.apply(map_.points[seen])
        derivatives = projection_derivatives(map_.camera, in_camera)
        # The point is ray / value in the first camera.
        along = (-rays[seen] / values[seen, None] ** 2) @ (cam_from_world.R @ first.R).T
        by_value = np.einsum("nij,nj->ni", derivatives, along)
        finite = np.isfinite(by_value).all(axis=1)
        seen, by_value = seen[finite], by_value[finite]
        np.add.at(information, seen, np.sum(by_value**2, axis=1))
        moved = np.einsum("ni,nij->nj", by_value, by_pose(derivatives[finite], in_camera[finite]))
        cross[seen, 6 * k : 6 * k + 6] += moved
    kept = (points[:, 2] > 0) & (information > 0) & np.isfinite(values)
    known = information[kept]
    return InverseDepths(rays[kept], values[kept], map_.noise_px / np.sqrt(known), -cross[kept] / known[:, None])
