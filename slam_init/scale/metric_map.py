"""A map in metres."""

from __future__ import annotations

from dataclasses import replace
from numbers import Real

import numpy as np

from slam_init.errors import SlamInitError, check_type
from slam_init.types.arrays import Floats
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose
from slam_init.types.scale import Scale

#: Relative standard deviation of the range that holds the scale of a map in its own unit, see
#: :mod:`slam_init.bundle.graph`.
_HELD_SIGMA = 1e-3


def in_metres(map_: InitialMap, scale: Scale) -> InitialMap:
    """Change the unit of a map to metres.

    The graph keeps the scale: the range factor between the first camera and the one farthest from it measures metres,
    with the standard deviation of the scale. The covariances of the poses are those of this graph, so that they include
    it.
    """
    InitialMap.check(map_)
    check_type(scale, Scale, "the scale", "what slam_init.find_scale returns")
    if scale.metres_per_unit is None or scale.sigma is None:
        raise SlamInitError(f"the map stays in its own unit: {scale.reason or 'the scale was not found'}")
    numbers = (scale.metres_per_unit, scale.sigma)
    if not all(isinstance(number, Real) and 0 <= number < np.inf for number in numbers) or not numbers[0] > 0:
        raise SlamInitError(f"the scale has {numbers!r:.60} metres a unit and deviation: give positive numbers")
    if map_.scale is not None:
        raise SlamInitError("the map is in metres already: scale the map of the initializer")
    factor = scale.metres_per_unit
    # The variance of the held scale is replaced by that of the known one. Nothing but the range factor knows the scale,
    # so that it is independent of all else. It moves a camera along the line from the first one, and so a landmark.
    unit = np.repeat([1.0, factor], 3)
    pose_covariances = map_.pose_covariances * np.outer(unit, unit)
    poses = [keyframe.world_from_cam for keyframe in map_.keyframes]
    moved = np.array([factor * pose.R.T @ (pose.t - poses[0].t) for pose in poses])
    pose_covariances[:, 3:, 3:] += _of_scale(scale.sigma, moved)
    return replace(
        map_,
        keyframes=scaled_keyframes(map_.keyframes, factor),
        points=factor * map_.points,
        points_before=factor * map_.points_before,
        keyframes_before=tuple(Pose(pose.R, factor * pose.t) for pose in map_.keyframes_before),
        recipe=map_.recipe and map_.recipe.in_unit(factor, scale.sigma),
        pose_covariances=pose_covariances,
        point_covariances=factor**2 * (map_.point_covariances + _of_scale(scale.sigma, map_.points)),
        depth_sigmas=np.sqrt(np.maximum(map_.depth_sigmas**2 + scale.sigma**2 - _HELD_SIGMA**2, 0.0)),
        scale_uncertainty=map_.scale_uncertainty.with_scale(scale.sigma**2 - _HELD_SIGMA**2),
        gauge=f"first pose fixed; distance from the first camera to the farthest one known to {scale.sigma:.2g} of it",
        scale=scale,
        gravity=scale.gravity or map_.gravity,
    )


def _of_scale(sigma: float, offsets: Floats) -> Floats:
    """Covariances (..., 3, 3) of offsets (..., 3) from the first camera, by a scale instead of the held one."""
    return np.asarray((sigma**2 - _HELD_SIGMA**2) * offsets[..., :, None] * offsets[..., None, :])


def scaled_keyframes(keyframes: tuple[Keyframe, ...], factor: float) -> tuple[Keyframe, ...]:
    """Change the unit of keyframes."""
    scaled = (Pose(one.world_from_cam.R, factor * one.world_from_cam.t) for one in keyframes)
    return tuple(replace(one, world_from_cam=pose) for one, pose in zip(keyframes, scaled, strict=True))
