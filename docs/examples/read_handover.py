"""Read ``handover.npz`` without slam-init: keyframes, points and what each keyframe sees, as a SLAM system needs them.

The arrays are described in :mod:`slam_init.output.handover`. Only numpy is needed, so the function can be copied.

Run it as ``python docs/examples/read_handover.py FOLDER/handover.npz``.
"""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np


def read_handover(path: str) -> list[dict[str, Any]]:
    """Read the keyframes, each with the points that it sees.

    * Returns: For each keyframe: ``id``, ``time``, ``cam_from_world`` (4, 4), and by observation ``pixels`` (N, 2),
      ``point_ids`` (N,), ``points`` (N, 3) in the world, ``descriptors`` (N, 32).
    """
    with np.load(path, allow_pickle=False) as file:
        if str(file.get("format")) != "slam-init-handover" or int(file["version"]) != 1:
            raise ValueError(f"{path} is no slam-init handover of version 1")
        data = {name: file[name] for name in file.files}
    keyframes = []
    for k, (frame, time_s) in enumerate(zip(data["keyframe_frames"], data["keyframe_times"], strict=True)):
        rows = data["observation_keyframes"] == k
        seen = data["observation_points"][rows]
        keyframes.append(
            {
                "id": int(frame),
                "time": float(time_s),
                "cam_from_world": np.linalg.inv(data["keyframe_poses"][k]),
                "pixels": data["observation_pixels"][rows],
                "point_ids": data["point_ids"][seen],
                "points": data["points"][seen],
                "descriptors": data["point_descriptors"][seen],
            }
        )
    return keyframes


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line for each keyframe."""
    arguments = sys.argv[1:] if argv is None else argv
    try:
        keyframes = read_handover(arguments[0] if arguments else "slam-init-out/handover.npz")
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        print(f"read_handover: {error}", file=sys.stderr)
        return 2
    for keyframe in keyframes:
        x, y, z = np.linalg.inv(keyframe["cam_from_world"])[:3, 3]
        print(f"keyframe {keyframe['id']}: {len(keyframe['pixels'])} points, at {x:.4f} {y:.4f} {z:.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
