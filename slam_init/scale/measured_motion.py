"""The scale of a map from the record of an inertial sensor, or why the record does not determine it.

Accelerations that change determine the scale: a constant one looks like a tilt of gravity. Whether the motion has
enough of them is the standard deviation of the scale in the joint estimate (:mod:`slam_init.bundle.inertial`). Whether
the record belongs to the camera is asked before, by the chi-square test: first of the rotations, then of the whole
motion.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from slam_init.bundle.graph import joint_pose_covariance
from slam_init.bundle.inertial import VisualInertial
from slam_init.scale.requests import NoScaleError
from slam_init.types.inertial import Gravity, InertialRecord
from slam_init.types.initial_map import InitialMap
from slam_init.types.scale import Scale, ScaleOrigin

#: The positions of three frames give two velocities, and their difference is fitted by gravity and the scale: a wrong
#: record could not be distinguished from a right one.
#: Class: geometry.
_LEAST_KEYFRAMES = 4
#: A scale that is known worse than this is none. The deviation is that of linearized equations: a scale of half of the
#: true value fits poses with so much noise as well, since noise is motion for the map and none for the sensor.
#: Class: level.
_WORST_SIGMA = 0.1
#: A record whose residuals are larger by chance only once in a thousand maps is not that of the camera.
#: Class: level.
_LEAST_PROBABILITY = 1e-3

_MOVE = "move the camera to and fro, or add --refine 30"


def scale_of_motion(map_: InitialMap, record: InertialRecord | None, grown: InitialMap | None = None) -> Scale:
    """Find the scale of a map, or raise why there is none.

    * ``grown``: The same map with more keyframes. It is used where it still has those of the map.
    * Returns: With the direction of gravity in the world of the map.
    """
    from scipy.special import chdtrc  # the probability that a sum of squares is larger by chance

    known = {keyframe.frame: keyframe.world_from_cam.t for keyframe in map_.keyframes}
    first = map_.keyframes[0].frame
    ends = {first, max(known, key=lambda frame: float(np.linalg.norm(known[frame] - known[first])))}  # and the farthest
    source = grown if grown is not None and ends <= {keyframe.frame for keyframe in grown.keyframes} else map_
    count = len(source.keyframes)
    if record is None:
        raise NoScaleError("the source has no record of an inertial sensor")
    if count < _LEAST_KEYFRAMES:
        few = f"the map has {count} keyframes, and {_LEAST_KEYFRAMES} are needed"
        raise NoScaleError(f"{few}: add --refine 30 or --continue 30")
    if source.graph is None:
        raise NoScaleError("the map has no covariance of its poses")
    frames = tuple(keyframe.frame for keyframe in source.keyframes)
    poses = tuple(keyframe.world_from_cam for keyframe in source.keyframes)
    times_s = np.array([keyframe.timestamp_s for keyframe in source.keyframes])
    if any(record.steps(t0_s, t1_s) is None for t0_s, t1_s in pairwise(times_s.tolist())):
        span = f"from {times_s[0]:.3f} to {times_s[-1]:.3f} s"
        raise NoScaleError(f"{record.name} does not cover the keyframes {span} without gaps")
    covariance = joint_pose_covariance(source.graph, source.values, frames)
    motion = VisualInertial(times_s, poses, covariance, record)
    misfit, rotations = motion.turning_misfit
    if chdtrc(rotations, misfit) < _LEAST_PROBABILITY:
        raise _of_another_camera(record, f"turned otherwise (chi-square {misfit:.0f} of {rotations} rotations)")
    far = frames.index(max(ends - {frames[0]}, default=frames[-1]))
    found = motion.align(far)
    if found is None:
        raise NoScaleError(f"no scale fits the accelerations: {_MOVE}")
    if chdtrc(found.freedom, found.chi_square) < _LEAST_PROBABILITY:
        test = f"chi-square {found.chi_square:.0f} with {found.freedom} degrees of freedom"
        raise _of_another_camera(record, f"moved otherwise ({test})")
    if not found.sigma <= _WORST_SIGMA:
        raise NoScaleError(f"the accelerations determine the scale to +- {found.sigma:.0%} only: {_MOVE}")
    units = float(np.linalg.norm(known[frames[far]] - known[frames[0]]))
    gravity = Gravity(poses[0].R @ found.gravity.down, found.gravity.sigma_deg)
    return Scale(
        ScaleOrigin.IMU,
        found.distance_m / units,
        found.sigma,
        f"{record.name} between {count} keyframes in {times_s[-1] - times_s[0]:.2g} s, "
        f"gravity to {gravity.sigma_deg:.1g} deg",
        gravity=gravity,
    )


def _of_another_camera(record: InertialRecord, how: str) -> NoScaleError:
    check = "check the pose of the sensor in the camera and the clocks"
    return NoScaleError(f"{record.name} does not belong to the camera: it {how}: {check}")
