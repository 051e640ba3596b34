"""A hand that moves a camera to and fro, the map that the camera makes of it, and the record of a sensor beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from make_metric import adjusted_map
from make_scene import cloud

from quest.geometry.quaternion import rotation_from_vector
from sequences_synth.inertial import InertialNoise, measure
from slam_init.types.inertial import InertialRecord
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose

#: A sensor without errors.
EXACT = InertialNoise(0.0, 0.0, 0.0, 0.0, 0.0)
#: Directions of gravity and of the optical axis: the y axis of the camera points down, the z axis of the world up.
LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def swayed(time_s: float) -> np.ndarray:
    """The pose (4, 4) of a hand that sways by some centimetres twice a second, and walks on."""
    pose, phase = np.eye(4), 2 * np.pi * time_s
    turn = np.array([0.04 * np.sin(1.7 * phase), 0.05 * np.sin(phase + 1), 0.03 * np.cos(1.3 * phase)])
    pose[:3, :3] = LEVEL @ rotation_from_vector(turn)
    pose[:3, 3] = 0.3 * time_s + 0.02 * np.sin(2 * phase), 0.03 * np.sin(phase), 0.04 * np.cos(1.7 * phase)
    return pose


def straight(time_s: float) -> np.ndarray:
    """A car that drives straight on at a constant speed."""
    pose = np.eye(4)
    pose[:3, :3] = LEVEL
    pose[:3, 3] = 0.5 * time_s, 0.0, 0.0
    return pose


def recorded(path=swayed, noise: InertialNoise | None = None, seed=0, **changed) -> InertialRecord:
    """What the sensor measures in the first two seconds."""
    samples = measure(path, np.arange(-0.1, 2.0, 0.005), np.random.default_rng(seed), noise)
    pose = Pose(samples.cam_from_imu[:3, :3], samples.cam_from_imu[:3, 3])
    record = InertialRecord(samples.timestamps_s, samples.rates_rad_s, samples.accelerations_m_s2, pose)
    return replace(record, **changed)


def map_of(path=swayed, noise_px=0.2, seed=0, count=8, step_s=0.15) -> InitialMap:
    """A map of views of the path, in units of its median depth, with the times of the views."""
    times_s = step_s * np.arange(count)
    poses = [Pose(pose[:3, :3], pose[:3, 3]) for pose in map(path, times_s.tolist())]
    first = poses[0].inverse()
    poses = [first @ pose for pose in poses]
    made = adjusted_map(cloud(np.random.default_rng(2)), noise_px, seed, poses)
    keyframes = zip(made.keyframes, times_s.tolist(), strict=True)
    return replace(made, keyframes=tuple(replace(keyframe, timestamp_s=time_s) for keyframe, time_s in keyframes))


def metres_per_unit(map_: InitialMap, path=swayed) -> float:
    """By the distance of the last camera from the first."""
    first, last = (path(map_.keyframes[k].timestamp_s)[:3, 3] for k in (0, -1))
    units = np.linalg.norm(map_.keyframes[-1].world_from_cam.t - map_.keyframes[0].world_from_cam.t)
    return float(np.linalg.norm(last - first) / units)
