"""Snapshot of the map of a trial in one small file, for the recording that shows all methods side by side."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from slam_init.evaluation.metrics import align_poses
from slam_init.types.arrays import Floats, Image
from slam_init.types.pose import Trajectory
from slam_init.types.result import Result


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The map of a trial, or the reason why there is no map."""

    #: (A, 3) Second frame, verdict and advice of each attempt.
    verdicts: np.ndarray[tuple[int, ...], np.dtype[np.str_]]
    #: Why there is no map; empty if there is a map.
    reason: str
    #: Absolute index of the last frame that was read. A map was accepted at this frame.
    last_frame: int
    #: (K, 4, 4) World_from_cam of the keyframes; empty if there is no map.
    poses: Floats
    #: (L, 3) Landmarks in the world frame of the map.
    points: Floats
    #: (L, 3) Colours of the landmarks, RGB.
    colors: Image
    #: (N, 3) True camera positions from the first keyframe to the last, aligned with the map by a similarity; empty
    #: if there is no ground truth.
    truth: Floats


def save_snapshot(path: str | os.PathLike[str], result: Result, start: int, truth: Trajectory | None) -> None:
    """Write the snapshot of a trial."""
    attempts = [(str(a.frames[1] if len(a.frames) > 1 else -1), a.verdict, a.advice) for a in result.attempts]
    map_ = result.map
    keyframes = () if map_ is None else map_.keyframes
    poses = np.array([keyframe.world_from_cam.matrix() for keyframe in keyframes]).reshape(-1, 4, 4)
    snapshot = MapSnapshot(
        verdicts=np.array(attempts, np.str_).reshape(-1, 3),
        reason=result.reason or "",
        last_frame=start + result.frames_read - 1,
        poses=poses,
        points=np.zeros((0, 3)) if map_ is None else map_.points,
        colors=np.zeros((0, 3), np.uint8) if map_ is None else map_.colors,
        truth=_true_path(result, truth),
    )
    np.savez(path, **vars(snapshot))


def load_snapshot(path: str | os.PathLike[str]) -> MapSnapshot:
    """Read a snapshot."""
    with np.load(path) as stored:
        fields = {name: stored[name] for name in stored.files}
    return MapSnapshot(**fields | {"reason": str(fields["reason"]), "last_frame": int(fields["last_frame"])})


def _true_path(result: Result, truth: Trajectory | None) -> Floats:
    if result.map is None or truth is None:
        return np.zeros((0, 3))
    pairs = [(true, k) for k in result.map.keyframes if (true := truth.at(k.timestamp_s)) is not None]
    if len(pairs) < 2:
        return np.zeros((0, 3))
    world_from_gt = align_poses([true for true, _ in pairs], [keyframe.world_from_cam for _, keyframe in pairs])
    times = truth.timestamps_s
    first, last = (int(np.argmin(np.abs(times - pairs[i][1].timestamp_s))) for i in (0, -1))
    return world_from_gt.apply(np.array([pose.t for pose in truth.world_from_cam[first : last + 1]]))
