"""From the poses of views to a bundle-adjusted map, and to its :class:`~slam_init.types.initial_map.InitialMap`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from quest.tails import poisson_tail
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.graph import GAUGE
from slam_init.bundle.problem import BundleFailure, BundleProblem, BundleSolution, PosePrior, min_parallax_rad
from slam_init.config import Config
from slam_init.mapping.resection import parallax_rad, triangulate
from slam_init.mapping.views import TrackTable
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.inertial import Gravity
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

#: Bundle adjustment needs at least this many points.
_MIN_POINTS = 6
#: Directions of gravity contradict each other where they do so by chance only once in so many maps.
#: Class: level.
_CONTRADICTION = 1e-3


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
    usable = np.isfinite(points).all(axis=1)
    for row in (0, 1):
        rays = np.nan_to_num(table.bearings[row])
        local = poses[row].inverse().apply(np.nan_to_num(points))
        local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-300)
        usable &= np.einsum("ij,ij->i", local, rays) > 0  # in front of the camera
        usable &= np.linalg.norm(local - rays, axis=1) < threshold_rad
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
    return BundleProblem(
        frames=tuple(table.frames[k] for k in views),
        world_from_cam=tuple(first_from_world @ poses[k] for k in views),
        points=first_from_world.apply(points[usable]),
        track_ids=table.track_ids[usable],
        views=view_index.astype(np.int64),
        landmarks=(np.cumsum(usable) - 1)[track_index],
        pixels=table.pixels[views][observed],
    )


def mean_gravity(keyframes: Sequence[Keyframe], gravities: Mapping[int, Gravity]) -> Gravity | None:
    """The direction of gravity in the world, by those of keyframes.

    * Returns: None without any, and where they contradict each other. The offset of an accelerometer is the same in
      all of them, so that the mean is no more certain than one.
    """
    known = [
        (keyframe.world_from_cam.R, gravities[keyframe.frame]) for keyframe in keyframes if keyframe.frame in gravities
    ]
    if not known:
        return None
    down, sigmas_deg = np.array([R @ one.down for R, one in known]), np.array([one.sigma_deg for _, one in known])
    mean = np.average(down, axis=0, weights=1 / sigmas_deg**2)
    if not mean.any():
        return None
    mean /= np.linalg.norm(mean)
    off_deg = np.degrees(np.arccos(np.clip(down @ mean, -1, 1)))
    # Of chi-square with an even number of degrees of freedom, here two for each further direction.
    by_chance = 1 - poisson_tail(len(known) - 1, 0.5 * float(np.sum((off_deg / sigmas_deg) ** 2)))
    if len(known) > 1 and by_chance < _CONTRADICTION:
        return None
    return Gravity(mean, float(np.sqrt(np.mean(sigmas_deg**2))))


def initial_map(
    bundle: BundleSolution, views: Sequence[Observations], scene: str, gravities: Mapping[int, Gravity] | None = None
) -> InitialMap:
    """Build the map of an adjusted bundle.

    * ``views``: The observations of the frames of the bundle, in the same order. Landmarks without a color become grey.
    * ``gravities``: By frame.
    """
    problem, newest = bundle.problem, views[-1].through(bundle.camera)
    colors = np.full((len(problem.points), 3), 128, np.uint8)
    for view in views:
        _, at, of = np.intersect1d(problem.track_ids, view.track_ids, return_indices=True)
        if len(view.colors):
            colors[at] = view.colors[of]
    keyframes = tuple(
        Keyframe(view.frame, view.timestamp_s, view.name, pose)
        for view, pose in zip(views, problem.world_from_cam, strict=True)
    )
    return InitialMap(
        keyframes=keyframes,
        points=problem.points,
        track_ids=problem.track_ids,
        observation_keyframes=problem.views,
        observation_landmarks=problem.landmarks,
        observation_pixels=problem.pixels,
        colors=colors,
        pose_covariances=bundle.pose_covariances,
        point_covariances=bundle.point_covariances,
        depth_sigmas=bundle.depth_sigmas,
        scale_uncertainty=bundle.scale_uncertainty,
        open_tracks=newest.at(np.flatnonzero(~np.isin(newest.track_ids, problem.track_ids))),
        gauge=GAUGE,
        recipe=bundle.recipe,
        points_before=bundle.before.points,
        keyframes_before=bundle.before.world_from_cam,
        bundle_errors=bundle.errors,
        reprojection_rmse_px=bundle.rmse_px,
        median_parallax_deg=float(np.degrees(np.median(problem.parallax_rad()))),
        noise_px=bundle.noise_px,
        scene=scene,
        camera=bundle.camera,
        focal_factor=bundle.focal_factor,
        focal_factor_sigma=bundle.focal_factor_sigma,
        gravity=mean_gravity(keyframes, gravities or {}),
    )
