"""Monocular SLAM initialization: from a video to a bundle-adjusted map, on planes too, or a reason why not.

The names below are loaded when they are first used, so that ``import slam_init`` and the command line stay quick.
Attempts and refusals are told to the logger ``slam_init`` at the levels INFO and DEBUG; the library prints nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from slam_init.types.savable import set_writer

if TYPE_CHECKING:
    from slam_init.calibration.files import load_camera
    from slam_init.calibration.prior import prior_camera
    from slam_init.config import Config, load_config
    from slam_init.datasets.opening import open_source
    from slam_init.decision.audit import audit
    from slam_init.errors import CalibrationError, ConfigError, OutputError, SlamInitError, SourceError
    from slam_init.exports import export
    from slam_init.initializer import Initializer
    from slam_init.mapping.follower import Follower
    from slam_init.output.colmap import pycolmap_reconstruction
    from slam_init.output.results import load_graph, write_colmap, write_results
    from slam_init.runner import run
    from slam_init.scale.find import find_scale
    from slam_init.scale.metric_map import in_metres
    from slam_init.scale.requests import parse_scale
    from slam_init.types.audit import Audit, AuditVerdict
    from slam_init.types.camera import Camera
    from slam_init.types.frame import Frame, Observations
    from slam_init.types.gates import Gate
    from slam_init.types.initial_map import InitialMap, Keyframe
    from slam_init.types.pose import Pose, Trajectory
    from slam_init.types.reasons import Verdict
    from slam_init.types.result import Attempt, Result, Segment
    from slam_init.types.scale import Scale
    from slam_init.types.status import Status

    __version__: str

__all__ = [
    "Attempt",
    "Audit",
    "AuditVerdict",
    "CalibrationError",
    "Camera",
    "Config",
    "ConfigError",
    "Follower",
    "Frame",
    "Gate",
    "InitialMap",
    "Initializer",
    "Keyframe",
    "Observations",
    "OutputError",
    "Pose",
    "Result",
    "Scale",
    "Segment",
    "SlamInitError",
    "SourceError",
    "Status",
    "Trajectory",
    "Verdict",
    "__version__",
    "audit",
    "export",
    "find_scale",
    "in_metres",
    "load_camera",
    "load_config",
    "load_graph",
    "open_source",
    "parse_scale",
    "prior_camera",
    "pycolmap_reconstruction",
    "run",
    "write_colmap",
    "write_results",
]

_HOMES = {
    "Attempt": "types.result",
    "Audit": "types.audit",
    "AuditVerdict": "types.audit",
    "CalibrationError": "errors",
    "Camera": "types.camera",
    "Config": "config",
    "ConfigError": "errors",
    "Follower": "mapping.follower",
    "Frame": "types.frame",
    "Gate": "types.gates",
    "InitialMap": "types.initial_map",
    "Initializer": "initializer",
    "Keyframe": "types.initial_map",
    "Observations": "types.frame",
    "OutputError": "errors",
    "Pose": "types.pose",
    "Result": "types.result",
    "Scale": "types.scale",
    "Segment": "types.result",
    "SlamInitError": "errors",
    "SourceError": "errors",
    "Status": "types.status",
    "Trajectory": "types.pose",
    "Verdict": "types.reasons",
    "audit": "decision.audit",
    "export": "exports",
    "find_scale": "scale.find",
    "in_metres": "scale.metric_map",
    "load_camera": "calibration.files",
    "load_config": "config",
    "load_graph": "output.results",
    "open_source": "datasets.opening",
    "parse_scale": "scale.requests",
    "prior_camera": "calibration.prior",
    "pycolmap_reconstruction": "output.colmap",
    "run": "runner",
    "write_colmap": "output.results",
    "write_results": "output.results",
}

set_writer(lambda thing, folder: import_module("slam_init.output.results").save(thing, folder))


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("slam-init")
        except PackageNotFoundError:
            return "0+unknown"
    if name in _HOMES:
        return getattr(import_module(f"slam_init.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'slam_init' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
