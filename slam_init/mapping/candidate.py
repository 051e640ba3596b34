"""From the poses of views to a bundle-adjusted map."""

from __future__ import annotations

import numpy as np

from slam_init.bundle.adjustment import adjust
from slam_init.bundle.problem import BundleFailure, BundleProblem, BundleSolution, PosePrior, min_parallax_rad
from slam_init.config import Config
from slam_init.mapping.triangulation import parallax_rad, triangulate
from slam_init.mapping.views import TrackTable
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

#: Bundle adjustment needs at least this many points.
_MIN_POINTS = 6


def map_of_poses(
    camera: Camera,
    config: Config,
    table: TrackTable,
    cam_from_world: dict[int, Pose],
    threshold_rad: float,
    prior: PosePrior | None = None,
    focal_factor: float = 1.0,
) -> BundleSolution | BundleFailure:
    """Build the bundle-adjusted map of views whose poses are known.

    * ``cam_from_world``: By absolute frame index; reference and current are among them. Other views of the table are
      left out.
    * ``threshold_rad``: An observation farther from its point does not make the point a landmark.
    * ``focal_factor``: Where the focal length is adjusted: its first estimate, over the stated one.
    """
    rows = [row for row, frame in enumerate(table.frames) if frame in cam_from_world]
    poses = {row: cam_from_world[table.frames[row]].inverse() for row in rows}
    points = triangulate(list(poses.values()), table.bearings[rows])
    usable = _before_all(points, {row: poses[row] for row in (0, 1)}, table)
    for row in (0, 1):
        local = poses[row].inverse().apply(np.nan_to_num(points))
        local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-300)
        usable &= np.linalg.norm(local - np.nan_to_num(table.bearings[row]), axis=1) < threshold_rad
    usable &= parallax_rad(points, poses[0].t, poses[1].t) > min_parallax_rad(
        camera, config.map.min_noise_px, config.map
    )
    problem = _bundle_problem(table, points, usable, poses)
    if len(problem.points) < _MIN_POINTS:
        return BundleFailure(f"only {len(problem.points)} points can be triangulated")
    return adjust(
        camera, problem if prior is None else problem.with_prior(prior), config.map, focal_factor, poses_known=True
    )


def _bundle_problem(table: TrackTable, points: Floats, usable: Bools, poses: dict[int, Pose]) -> BundleProblem:
    """Gather the views in time order, with the first of them as the world frame, and the usable points they observe."""
    views = sorted(poses, key=lambda k: table.frames[k])
    first_from_world = poses[views[0]].inverse()
    observed = np.isfinite(table.bearings[views, :, 0]) & usable
    view_index, track_index = np.nonzero(observed)
    tracks = np.flatnonzero(usable)
    position = np.full(len(usable), -1)
    position[tracks] = np.arange(len(tracks))
    return BundleProblem(
        frames=tuple(table.frames[k] for k in views),
        world_from_cam=tuple(first_from_world @ poses[k] for k in views),
        points=first_from_world.apply(points[tracks]),
        track_ids=table.track_ids[tracks],
        views=view_index.astype(np.int64),
        landmarks=position[track_index].astype(np.int64),
        pixels=table.pixels[views][observed],
    )


def _before_all(points: Floats, poses: dict[int, Pose], table: TrackTable) -> Bools:
    """Return which points lie in front of all cameras, in the direction of their rays."""
    before = np.isfinite(points).all(axis=1)
    for k, world_from_cam in poses.items():
        in_camera = world_from_cam.inverse().apply(points)
        before &= np.einsum("ij,ij->i", in_camera, np.nan_to_num(table.bearings[k])) > 0
    return np.asarray(before)
