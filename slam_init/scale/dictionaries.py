"""OpenCV's dictionaries of markers, by the names that people write."""

from __future__ import annotations

from typing import Any

from slam_init.errors import ConfigError


def marker_dictionary(name: str) -> Any:
    """Look up a dictionary of markers."""
    import cv2

    known = {key.upper(): key for key in sorted(vars(cv2.aruco)) if key.startswith("DICT_")}
    wanted = name.strip().upper().removeprefix("DICT_").removeprefix("APRILTAG_")
    wanted = (
        f"APRILTAG_{wanted.removeprefix('TAG')}" if f"DICT_APRILTAG_{wanted.removeprefix('TAG')}" in known else wanted
    )
    if f"DICT_{wanted}" not in known:
        raise ConfigError(
            f"unknown marker dictionary {name[:40]!r}: give tag36h11, tag25h9, tag16h5, 4x4_50, 5x5_100, 6x6_250, ..."
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known[f"DICT_{wanted}"]))
