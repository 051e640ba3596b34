"""Makes the place of a drawn map: points, descriptors, and the views that see them."""

import itertools
from dataclasses import replace

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.initial_map import Keyframe
from slam_init.types.join import Similarity
from slam_init.types.place import Place
from slam_init.types.pose import Pose


def make_place(seed=0, points=120, views=4, noise_rad=0.0):
    """Points 3 to 6 units before cameras that move sideways."""
    rng = np.random.default_rng(seed)
    X = rng.uniform([-2, -2, 3], [2, 2, 6], (points, 3))
    described = np.abs(rng.normal(size=(points, 128)))
    described /= np.linalg.norm(described, axis=1, keepdims=True)
    keyframes = tuple(
        Keyframe(
            k, float(k), str(k), Pose(rotation_from_vector(0.05 * rng.normal(size=3)), np.array([0.3 * k, 0, 0.1]))
        )
        for k in range(views)
    )
    view, point = np.array(list(itertools.product(range(views), range(points)))).T
    rays = rays_to(keyframes, view, X[point]) + noise_rad * rng.normal(size=(len(view), 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return Place(keyframes, X, described, view, point, rays, max(noise_rad, 1e-4))


def rays_to(keyframes, view, X):
    """Unit rays (N, 3) from views to points (N, 3)."""
    poses = [keyframe.world_from_cam.inverse() for keyframe in keyframes]
    rays = np.array([poses[k].apply(x) for k, x in zip(view, X, strict=True)])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def moved(place, similarity: Similarity):
    """The same place in another frame and unit: its rays stay."""
    keyframes = tuple(replace(one, world_from_cam=similarity.pose(one.world_from_cam)) for one in place.views)
    return replace(place, views=keyframes, points=similarity.apply(place.points))
