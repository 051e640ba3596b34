"""Builds the :class:`~slam_init.types.initial_map.InitialMap` from an adjusted bundle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.bundle.problem import BundleSolution
from slam_init.frontend.tracks import History
from slam_init.types.frame import Observations
from slam_init.types.initial_map import InitialMap, Keyframe


@dataclass(frozen=True, eq=False)
class MapWithViews:
    """A map, and the observations of its keyframes, which the history may have dropped when the map is accepted."""

    map: InitialMap
    #: The observations of the keyframes, in the same order.
    views: tuple[Observations, ...]


def map_with_views(history: History, bundle: BundleSolution, scene: str) -> MapWithViews:
    """Build the map of an adjusted bundle, with the observations of its keyframes."""
    views = tuple(history[frame] for frame in bundle.problem.frames)
    return MapWithViews(initial_map(bundle, views, scene), views)


def initial_map(bundle: BundleSolution, views: Sequence[Observations], scene: str) -> InitialMap:
    """Build the map of an adjusted bundle.

    * ``views``: The observations of the frames of the bundle, in the same order. Landmarks without a color become grey.
    """
    problem, newest = bundle.problem, views[-1].through(bundle.camera)
    colors = np.full((len(problem.points), 3), 128, np.uint8)
    for view in views:
        _, at, of = np.intersect1d(problem.track_ids, view.track_ids, return_indices=True)
        if len(view.colors):
            colors[at] = view.colors[of]
    return InitialMap(
        keyframes=tuple(
            Keyframe(view.frame, view.timestamp_s, view.name, pose)
            for view, pose in zip(views, problem.world_from_cam, strict=True)
        ),
        points=problem.points,
        track_ids=problem.track_ids,
        observation_keyframes=problem.views,
        observation_landmarks=problem.landmarks,
        observation_pixels=problem.pixels,
        colors=colors,
        pose_covariances=bundle.pose_covariances,
        point_covariances=bundle.point_covariances,
        depth_sigmas=bundle.depth_sigmas,
        open_tracks=newest.at(np.flatnonzero(~np.isin(newest.track_ids, problem.track_ids))),
        gauge=bundle.gauge,
        graph=bundle.graph,
        values=bundle.values,
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
    )
