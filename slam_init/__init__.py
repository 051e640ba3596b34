"""Monocular SLAM initialization: from a video to a bundle-adjusted map, on planes too, or a reason why not.

The names below are loaded when they are first used, so that ``import slam_init`` and the command line stay quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slam_init.calibration.files import load_camera
    from slam_init.config import Config, load_config
    from slam_init.datasets import open_source
    from slam_init.errors import SlamInitError
    from slam_init.initializer import Initializer
    from slam_init.output.results import load_graph
    from slam_init.runner import run
    from slam_init.status import Status
    from slam_init.types.camera import Camera
    from slam_init.types.frame import Frame
    from slam_init.types.initial_map import InitialMap
    from slam_init.types.result import Result

__all__ = [
    "Camera",
    "Config",
    "Frame",
    "InitialMap",
    "Initializer",
    "Result",
    "SlamInitError",
    "Status",
    "load_camera",
    "load_config",
    "load_graph",
    "open_source",
    "run",
]

_HOME = {
    "Camera": "types.camera",
    "Config": "config",
    "Frame": "types.frame",
    "InitialMap": "types.initial_map",
    "Initializer": "initializer",
    "Result": "types.result",
    "SlamInitError": "errors",
    "Status": "status",
    "load_camera": "calibration.files",
    "load_config": "config",
    "load_graph": "output.results",
    "open_source": "datasets",
    "run": "runner",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"slam_init.{_HOME[name]}"), name)
    raise AttributeError(f"module 'slam_init' has no attribute {name!r}")
