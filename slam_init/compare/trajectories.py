"""The trajectory of each trial in the formats of other tools: TUM for evo, and the files of VSLAM-LAB.

For evo, ``evo/METHOD/SEQUENCE/00010.txt`` is the map of the trial that starts at frame 10, and
``evo/groundtruth/SEQUENCE.txt`` the truth. For VSLAM-LAB, ``vslam-lab/METHOD/SLAM-INIT/SEQUENCE`` is the folder of an
experiment, with ``00010_KeyFrameTrajectory.csv`` and ``groundtruth.csv``: time stamps in nanoseconds, x y z and a
quaternion with w last.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from slam_init.errors import OutputError
from slam_init.methods.external_command import method_label
from slam_init.output.colmap import numbers_text
from slam_init.output.names import folder_name
from slam_init.output.results import tum_text
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose, Trajectory

#: The folder of the trajectories in that of the results.
TRAJECTORIES = "trajectories"
_DATASET = "SLAM-INIT"
_TRUTH = "groundtruth"
_HEADER = "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw"


def trajectory_names(label: str, starts: Iterable[int], methods: Iterable[str]) -> Iterator[str]:
    """Return all trajectories that the trials of a source may write."""
    yield f"{TRAJECTORIES}/{_evo(_TRUTH, label)}.txt"
    frames = list(starts)
    for method in methods:
        yield f"{TRAJECTORIES}/{_vslam_lab(method, label)}/{_TRUTH}.csv"
        for start in frames:
            yield f"{TRAJECTORIES}/{_evo(method, label)}/{start:05d}.txt"
            yield f"{TRAJECTORIES}/{_vslam_lab(method, label)}/{start:05d}_KeyFrameTrajectory.csv"


def write_trajectory(
    folder: str | os.PathLike[str], method: str, label: str, start: int, keyframes: Sequence[Keyframe],
    truth: Trajectory | None,
) -> None:  # fmt: skip
    """Write the trajectory of a trial, and the true one."""
    poses = [(keyframe.timestamp_s, keyframe.world_from_cam) for keyframe in keyframes]
    files = {
        f"{_evo(method, label)}/{start:05d}.txt": tum_text(keyframes),
        f"{_vslam_lab(method, label)}/{start:05d}_KeyFrameTrajectory.csv": _csv(poses),
    }
    if truth is not None:
        true = list(zip(truth.timestamps_s.tolist(), truth.world_from_cam, strict=True))
        files[f"{_vslam_lab(method, label)}/{_TRUTH}.csv"] = _csv(true)
        files[f"{_evo(_TRUTH, label)}.txt"] = tum_text([Keyframe(i, t, "", pose) for i, (t, pose) in enumerate(true)])
    try:
        for name, text in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            # Several processes may write the same truth: each writes it whole.
            unfinished = path.with_name(f"{path.name}.{os.getpid()}")
            unfinished.write_text(text, encoding="ascii")
            unfinished.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {folder} ({error.strerror}): make room, or give another --out") from error


def _csv(poses: Sequence[tuple[float, Pose]]) -> str:
    rows = [_HEADER]
    for timestamp_s, pose in poses:
        w, x, y, z = pose.q_wxyz
        numbers = numbers_text([*pose.t, x, y, z, w]).replace(" ", ",")
        rows.append(f"{round(timestamp_s * 1e9)},{numbers}")
    return "\n".join(rows) + "\n"


def _evo(method: str, label: str) -> str:
    return f"evo/{folder_name(method_label(method))}/{folder_name(label)}"


def _vslam_lab(method: str, label: str) -> str:
    return f"vslam-lab/{folder_name(method_label(method))}/{_DATASET}/{folder_name(label)}"
