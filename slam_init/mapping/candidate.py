"""From one two-view hypothesis to an adjusted map with further views, and the comparison of two such maps.

A plane seen in two views has two explanations that fit equally well; each is carried to a map of its own here, and the
views between and around the pair vote by how well its points predict them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.estimate import Hypothesis, RelativePose
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.noise import min_parallax_rad
from slam_init.bundle.problem import BundleFailure, BundleProblem, BundleSolution
from slam_init.config import Config
from slam_init.mapping.triangulation import resect, triangulate
from slam_init.mapping.views import TrackTable
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

__all__ = ["MapCandidate", "build_candidate"]


@dataclass(frozen=True, eq=False)
class MapCandidate:
    """A hypothesis that was carried to a map, or why it could not be.

    Attributes
    ----------
    hypothesis : Hypothesis or RelativePose
    bundle : BundleSolution or BundleFailure
    table : TrackTable
    agreement : float
        Share of the landmarks' observations by further views that agree with the two-view map; NaN without any.
    placed : int
        Views that the two-view map could locate, the pair included; those of a short baseline are not in the bundle.
    """

    hypothesis: Hypothesis | RelativePose
    bundle: BundleSolution | BundleFailure
    table: TrackTable
    agreement: float
    placed: int


def build_candidate(
    camera: Camera,
    config: Config,
    table: TrackTable,
    hypothesis: Hypothesis | RelativePose,
    threshold_rad: float | None = None,
) -> MapCandidate:
    """Triangulate the pair, resect the further views, adjust everything.

    Parameters
    ----------
    camera : Camera
    config : Config
    table : TrackTable
    hypothesis : Hypothesis or RelativePose
    threshold_rad : float, optional
        Outliers of a further view are farther off than this; by default that of the configuration.
    """
    if threshold_rad is None:
        threshold_rad = config.two_view.threshold_px / camera.focal_px
    cam2_from_cam1 = Pose(hypothesis.R, hypothesis.t)
    poses = {0: Pose.identity(), 1: cam2_from_cam1.inverse()}  # view -> world_from_cam
    points = triangulate([poses[0], poses[1]], table.bearings[:2])
    usable = hypothesis.inliers & _before_all(points, poses, table)
    usable &= _parallax_rad(points, poses) > min_parallax_rad(camera, config.map.min_noise_px, config.map)
    seen, agreeing = 0, 0
    for k in range(2, len(table.frames)):
        visible = usable & np.isfinite(table.bearings[k, :, 0])
        if visible.sum() < config.map.min_resected:
            continue
        resected = resect(points[visible], table.bearings[k, visible], threshold_rad)
        seen += int(visible.sum())
        if resected is None:
            continue
        cam_from_world, inliers = resected
        agreeing += int(inliers.sum())
        if inliers.sum() >= config.map.min_resected:
            poses[k] = cam_from_world.inverse()
    agreement = agreeing / seen if seen else float("nan")
    placed = len(poses)
    # The tracks' way is a first guess at the baseline, rotation included; now it is known.
    share = {k: float(np.linalg.norm(poses[k].t) / np.linalg.norm(poses[1].t)) for k in poses if k > 1}
    least = config.map.min_motion_share * min(1.0, max(share.values(), default=0.0))
    poses = {k: pose for k, pose in poses.items() if share.get(k, np.inf) >= least}
    # In time order: the first view is the world.
    views = sorted(poses, key=lambda k: table.frames[k])
    first_from_world = poses[views[0]].inverse()
    observed = np.isfinite(table.bearings[views, :, 0]) & usable
    view_index, track_index = np.nonzero(observed)
    kept_tracks = np.flatnonzero(usable)
    position = np.full(len(usable), -1)
    position[kept_tracks] = np.arange(len(kept_tracks))
    problem = BundleProblem(
        frames=tuple(table.frames[k] for k in views),
        world_from_cam=tuple(first_from_world @ poses[k] for k in views),
        points=first_from_world.apply(points[kept_tracks]),
        track_ids=table.track_ids[kept_tracks],
        views=view_index.astype(np.int64),
        landmarks=position[track_index].astype(np.int64),
        pixels=table.pixels[views][observed],
    )
    if len(kept_tracks) < 6:
        bundle: BundleSolution | BundleFailure = BundleFailure(f"only {len(kept_tracks)} points can be triangulated")
    else:
        bundle = adjust(camera, problem, config.map)
    return MapCandidate(hypothesis, bundle, table, agreement, placed)


def _before_all(points: Floats, poses: dict[int, Pose], table: TrackTable) -> Bools:
    """Points that lie along their rays, not behind the cameras."""
    before = np.isfinite(points).all(axis=1)
    for k, world_from_cam in poses.items():
        in_camera = world_from_cam.inverse().apply(points)
        before &= np.einsum("ij,ij->i", in_camera, np.nan_to_num(table.bearings[k])) > 0
    return np.asarray(before)


def _parallax_rad(points: Floats, poses: dict[int, Pose]) -> Floats:
    rays = [points - pose.t for pose in (poses[0], poses[1])]
    a, b = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    return np.asarray(np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1, 1)))
