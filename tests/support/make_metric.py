"""Adjusted maps of scenes whose size in metres is known, and sightings of targets in them."""

import numpy as np
from make_bundle import MAP, ROTATING
from make_scene import CAMERA, observe, problem

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.problem import BundleSolution
from slam_init.mapping.map_building import initial_map
from slam_init.scale.planar_target import Sighting
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose

#: Corners of a square of side 1 as OpenCV lists those of a marker.
SQUARE = 0.5 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
#: A target ahead of the cameras of :data:`make_bundle.ROTATING`, turned by half a radian.
TARGET = Pose(rotation_from_vector(np.array([0.3, 0.4, 0.1])), np.array([0.1, 0.0, 1.1]))


def solve(points, noise_px=0.3, seed=0, poses=ROTATING, prior=None) -> BundleSolution:
    """Bundle adjustment of points that all poses see; poses and points are given in metres."""
    exact = problem(CAMERA, points, list(poses), noise_px, np.random.default_rng(seed))
    return adjust(CAMERA, exact if prior is None else exact.with_prior(prior), MAP)


def adjusted_map(points, noise_px=0.3, seed=0, poses=ROTATING, prior=None) -> InitialMap:
    """The same as a map, in units of its median depth."""
    bundle = solve(points, noise_px, seed, poses, prior)
    views = observe(CAMERA, poses, points, frames=bundle.problem.frames)
    return initial_map(bundle, views, "general")


def true_scale(map_: InitialMap, poses=ROTATING) -> float:
    """Metres for a unit of the map, by the distance of the farthest camera."""
    far = max(range(len(poses)), key=lambda k: np.linalg.norm(poses[k].t - poses[0].t))
    units = np.linalg.norm(map_.keyframes[far].world_from_cam.t - map_.keyframes[0].world_from_cam.t)
    return float(np.linalg.norm(poses[far].t - poses[0].t) / units)


def sightings(
    map_: InitialMap, side_m=0.1, noise_px=0.0, rng=None, poses=ROTATING, points=SQUARE, target=TARGET, number=0
):
    """What the keyframes see of a target of this size."""
    found = []
    for keyframe, pose in zip(map_.keyframes, poses, strict=True):
        pixels = CAMERA.project(pose.inverse().apply(target.apply(side_m * points)))
        if rng is not None:
            pixels = pixels + rng.normal(0, noise_px, pixels.shape)
        found.append(Sighting(keyframe.frame, number, side_m * points, pixels))
    return found
