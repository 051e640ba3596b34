"""Messages of rclpy from their fields, and the time stamps of views."""

from __future__ import annotations

from array import array
from importlib import import_module
from typing import Any

import numpy as np

from slam_init.types.frame import Frame
from slam_init.types.initial_map import Keyframe


def make_message(kind: str, **fields: Any) -> Any:
    """Make a message of rclpy, which takes arrays of bytes as :class:`array.array`, and a byte as ``bytes``."""
    package, _, name = kind.split("/")
    for key, value in fields.items():
        if isinstance(value, np.ndarray) and value.dtype == np.uint8:
            fields[key] = array("B", value.tobytes())
    if name == "DiagnosticStatus":
        fields["level"] = bytes([fields["level"]])
    return getattr(import_module(f"{package}.msg"), name)(**fields)


def stamp_of(view: Keyframe | Frame) -> int:
    """The time stamp of an image in nanoseconds, by its name."""
    return int(view.name.replace(".", ""))
